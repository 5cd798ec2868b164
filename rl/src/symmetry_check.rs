//! Statistical check of the irreps that an environment declares, from a random rollout.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use symmetry::{D2, Group, Irrep};

use crate::distributions::standard_normals;
use crate::env::{EnvSpec, Observations, Transition, VectorEnv};
use crate::error::{RlError, require};
use crate::rollout::{EpisodeStats, step};

/// Number of randomly transformed copies of all episodes in the randomisation test. If the observed
/// deviation from zero exceeds those of all 999 copies, the test rejects at a level of 1 / (999 +
/// 1).
const NUM_RANDOMISATIONS: usize = 999;

/// Minimum number of episodes that the check needs. A mean's deviation from zero, in standard
/// errors, is at most the root of the number of episodes (6.9 for 48), and the largest of many
/// random ones is around 4, so fewer episodes could not show a contradiction.
const MIN_EPISODES: usize = 48;

/// Difference, in standard errors, up to which two means' deviations from zero count as equal,
/// because of rounding errors.
const ROUNDING_TOLERANCE: f64 = 1e-9;

/// Runs `env` for `steps` steps with standard normal actions, and rejects the environment if the
/// data contradict the irreps in its [`EnvSpec`], as far as `group` acts on them.
///
/// If observations, actions and rewards transform under the group as declared, an episode and its
/// transformed episode are equally likely. So the mean of every quantity that changes its sign is
/// zero: of components of the vector and moments of the images, of products of two of these, and of
/// their products and those of the action with rewards and with changes in a step. The mean that
/// deviates most, in standard errors, is compared with those of the same episodes, each transformed
/// by a random element (a randomisation test). An environment that declares its irreps correctly is
/// rejected in at most 1 of 1000 checks, whatever the distributions.
///
/// The check assumes that the *distribution* of first states is symmetric (an environment that
/// always begins on one side is rejected), and that episodes, also of different environments, are
/// independent. It misses a wrong irrep that has no effect: of a component that never moves, in too
/// few episodes (some hundred are a good number), or if renaming explains everything, such as x and
/// y in a task without images.
///
/// # Errors
/// [`RlError::SymmetryViolated`] names the mean that is not zero. [`RlError::InvalidSetting`] for
/// fewer than 48 episodes, unfinished ones included. [`RlError::Environment`] if a step fails, and
/// [`RlError::NotFinite`] for infinite or NaN numbers.
pub fn check_symmetry(
    env: &mut dyn VectorEnv,
    group: Group,
    steps: usize,
    rng: &mut ChaCha8Rng,
) -> Result<(), RlError> {
    let spec = env.spec().clone();
    spec.check()?;
    let quantities = TestedQuantities::new(&spec, group);
    let episodes = quantities.episode_sums(env, steps, rng)?;
    let enough = episodes.len() >= MIN_EPISODES;
    let expected = "steps in which 48 episodes begin, in all environments together";
    require("steps", steps as f32, expected, enough)?;
    let mut elements = vec![D2::Identity; episodes.len()];
    let norms = quantities.norms(&episodes);
    let Some((worst, observed)) = quantities.largest_ratio(&episodes, &norms, &elements) else {
        return Ok(());
    };
    for _ in 0..NUM_RANDOMISATIONS {
        elements.fill_with(|| group.elements()[rng.random_range(0..group.order())]);
        let moved = quantities.largest_ratio(&episodes, &norms, &elements);
        // one random deviation as large is enough to accept
        if moved.is_some_and(|(_, moved)| moved > observed - ROUNDING_TOLERANCE) {
            return Ok(());
        }
    }
    let term = &quantities.terms[worst];
    Err(RlError::SymmetryViolated {
        what: quantities.name(term),
        irrep: quantities.irrep(term),
        deviation: observed,
    })
}

/// Factor of a quantity of one step whose mean over episodes is tested against zero. Indices are
/// those of the features of an observation (see [`TestedQuantities`]) and of the components of the
/// action.
#[derive(Clone, Copy, Debug)]
enum Factor {
    /// Feature of the observation: a component of its vector or a moment of its image.
    Feature(usize),
    /// Change of a feature of the observation in the step.
    Change(usize),
    /// Component of the action.
    Action(usize),
    /// Reward of the step.
    Reward,
}

/// Quantities of an environment's steps that change their sign under the group, and their
/// computation from observations, actions and rewards.
///
/// A view is the list of features of one observation: the components of its vector and, for each
/// channel of its image, the moments 1, x, y and xy, divided by the moment 1 of a channel of full
/// brightness.
struct TestedQuantities {
    spec: EnvSpec,
    /// Irrep of each feature of an observation: of the components of its vector, then of the
    /// moments of its image.
    feature_irreps: Vec<Irrep>,
    /// Quantities, each a product of these factors.
    terms: Vec<Vec<Factor>>,
}

impl TestedQuantities {
    fn new(spec: &EnvSpec, group: Group) -> Self {
        let moments = (0..spec.image_shape[2]).flat_map(|_| Irrep::ALL);
        let feature_irreps: Vec<Irrep> =
            spec.vector_irreps.iter().copied().chain(moments).collect();
        let mut quantities = Self { spec: spec.clone(), terms: Vec::new(), feature_irreps };
        let (features, actions) = (0..quantities.feature_irreps.len(), 0..spec.action_irreps.len());
        let mut terms: Vec<_> = features.clone().map(|i| vec![Factor::Feature(i)]).collect();
        terms.extend(features.clone().map(|i| vec![Factor::Feature(i), Factor::Reward]));
        terms.extend(actions.clone().map(|a| vec![Factor::Action(a), Factor::Reward]));
        for i in features.clone() {
            terms.extend(
                (i + 1..features.end).map(|j| vec![Factor::Feature(i), Factor::Feature(j)]),
            );
        }
        for a in actions.map(Factor::Action) {
            terms.extend(features.clone().map(|i| vec![a, Factor::Change(i)]));
            terms.extend(features.clone().map(|i| vec![a, Factor::Feature(i), Factor::Reward]));
        }
        // only for quantities that change their sign does symmetry imply a mean of zero
        let acts = |irrep: Irrep| group.elements().iter().any(|&g| irrep.sign(g) < 0);
        terms.retain(|term| acts(quantities.irrep(term)));
        quantities.terms = terms;
        quantities
    }

    /// Returns the irrep that gives the sign by which the product of the factors `term` changes
    /// under a group element.
    fn irrep(&self, term: &[Factor]) -> Irrep {
        let irreps = term.iter().map(|&factor| match factor {
            Factor::Feature(i) | Factor::Change(i) => self.feature_irreps[i],
            Factor::Action(a) => self.spec.action_irreps[a],
            Factor::Reward => Irrep::Trivial,
        });
        irreps.fold(Irrep::Trivial, |product, irrep| product * irrep)
    }

    /// Returns the name of the product of the factors `term` for an error message.
    fn name(&self, term: &[Factor]) -> String {
        let feature = |i: usize| match i.checked_sub(self.spec.vector_irreps.len()) {
            None => format!("vector component {i} ({})", self.feature_irreps[i]),
            Some(k) => {
                format!("moment {} of channel {} of the image", self.feature_irreps[i], k / 4)
            }
        };
        let names = term.iter().map(|&factor| match factor {
            Factor::Feature(i) => feature(i),
            Factor::Change(i) => format!("the change of {}", feature(i)),
            Factor::Action(a) => format!("action component {a} ({})", self.spec.action_irreps[a]),
            Factor::Reward => "the reward".to_owned(),
        });
        names.collect::<Vec<_>>().join(" times ")
    }

    /// Runs the environments with random actions and returns the sums of all tested quantities over
    /// each episode, unfinished episodes included.
    fn episode_sums(
        &self,
        env: &mut dyn VectorEnv,
        steps: usize,
        rng: &mut ChaCha8Rng,
    ) -> Result<Vec<Vec<f64>>, RlError> {
        let (spec, n) = (&self.spec, self.spec.num_envs);
        let mut observations = Observations::new(spec);
        env.reset(&mut observations).map_err(RlError::Environment)?;
        observations.check(spec, n)?;
        observations.check_finite(spec).map_err(|e| e.with_step(|_| Some(0)))?;
        let mut features: Vec<_> = (0..n).map(|i| self.features_of(&observations, i)).collect();
        let mut running = vec![EpisodeStats::default(); n];
        let mut sums = vec![vec![0.0; self.terms.len()]; n];
        let mut episodes = Vec::new();
        let mut transition = Transition::new(spec);
        let mut actions = vec![0.0; n * spec.action_irreps.len()];
        for _ in 0..steps {
            standard_normals(rng, &mut actions);
            step(env, &running, &actions, &mut transition)?;
            for (i, action) in actions.chunks(spec.action_irreps.len()).enumerate() {
                let ended = transition.outcomes[i].is_ended();
                let next = self.features_of(&transition.observations, i);
                // not the next observation, which belongs to another episode
                let after = if ended {
                    self.features_of(&transition.final_observations, i)
                } else {
                    next.clone()
                };
                let step_features = StepFeatures {
                    before: &features[i],
                    after: &after,
                    action,
                    reward: f64::from(transition.rewards[i]),
                };
                let terms = sums[i].iter_mut().zip(&self.terms);
                terms.for_each(|(sum, term)| *sum += step_features.value(term));
                features[i] = next;
                running[i].length += 1;
                if ended {
                    let fresh = vec![0.0; self.terms.len()];
                    episodes.push(std::mem::replace(&mut sums[i], fresh));
                    running[i].length = 0;
                }
            }
        }
        let open = sums.into_iter().zip(&running);
        episodes.extend(open.filter(|(_, e)| e.length > 0).map(|(episode, _)| episode));
        Ok(episodes)
    }

    /// Returns the features of the observation of environment `i`: the components of its vector,
    /// then the moments of its image.
    fn features_of(&self, observations: &Observations, i: usize) -> Vec<f64> {
        let (image, vector) = observations.sample(&self.spec, i);
        let [height, width, channels] = self.spec.image_shape;
        let mut moments = vec![0.0; 4 * channels];
        let full = 255.0 * (height * width) as f64;
        for (k, &byte) in image.iter().enumerate() {
            let (row, column) = (k / channels / width, k / channels % width);
            // pixel centres in [-1, 1], x to the right and y up
            let x = (2 * column + 1) as f64 / width as f64 - 1.0;
            let y = 1.0 - (2 * row + 1) as f64 / height as f64;
            let level = f64::from(byte) / full;
            let own = &mut moments[4 * (k % channels)..][..4];
            for (moment, factor) in own.iter_mut().zip([1.0, x, y, x * y]) {
                *moment += factor * level;
            }
        }
        vector.iter().map(|&v| f64::from(v)).chain(moments).collect()
    }

    /// Returns the norm of each tested quantity: the root of the sum over episodes of its squared
    /// sums, which no change of signs alters.
    fn norms(&self, episodes: &[Vec<f64>]) -> Vec<f64> {
        let squares = |k: usize| episodes.iter().map(|sums| sums[k] * sums[k]).sum::<f64>();
        (0..self.terms.len()).map(|k| squares(k).sqrt()).collect()
    }

    /// Returns the index of the tested quantity whose sum over the episodes, each transformed by
    /// its group element, is largest relative to the quantity's norm, and that ratio; `None` if all
    /// quantities are zero.
    fn largest_ratio(
        &self,
        episodes: &[Vec<f64>],
        norms: &[f64],
        elements: &[D2],
    ) -> Option<(usize, f64)> {
        let ratio = |(k, term): (usize, &Vec<Factor>)| {
            let irrep = self.irrep(term);
            let signed = |(sums, &g): (&Vec<f64>, &D2)| f64::from(irrep.sign(g)) * sums[k];
            let sum = episodes.iter().zip(elements).map(signed).sum::<f64>();
            (norms[k] > 0.0).then(|| (k, sum.abs() / norms[k]))
        };
        let ratios = self.terms.iter().enumerate().filter_map(ratio);
        ratios.max_by(|a, b| a.1.total_cmp(&b.1))
    }
}

/// One step of one environment: the action, the reward, and the features of the observations before
/// and after it.
struct StepFeatures<'a> {
    before: &'a [f64],
    after: &'a [f64],
    action: &'a [f32],
    reward: f64,
}

impl StepFeatures<'_> {
    fn value(&self, term: &[Factor]) -> f64 {
        let values = term.iter().map(|&factor| match factor {
            Factor::Feature(i) => self.before[i],
            Factor::Change(i) => self.after[i] - self.before[i],
            Factor::Action(a) => f64::from(self.action[a]),
            Factor::Reward => self.reward,
        });
        values.product()
    }
}
