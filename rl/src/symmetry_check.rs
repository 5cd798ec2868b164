//! Statistical check of the irreps that an environment declares, from a random rollout.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use symmetry::{D2, Group, Irrep};

use crate::distributions::{ActionDistribution, standard_normals};
use crate::env::{EnvSpec, Observations, Transition, VectorEnv};
use crate::error::{RlError, SymmetryViolation, require};
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

/// Runs `env` for `steps` steps with random actions, and rejects the environment if the data
/// contradict the irreps in its [`EnvSpec`], as far as `group` acts on them.
///
/// If observations, actions and rewards transform under the group as declared, an episode and its
/// transformed episode are equally likely. So the mean of every quantity that changes its sign is
/// zero. With features f (components of the vector, moments of the images), their changes d in a
/// step, action components a and the reward r, these quantities are f, d, f r, a r, products of two
/// features, a d, a d f of one feature, and a f r. Features that no element changes, and the
/// reward, enter with their mean subtracted. Deviations, in standard errors, are compared with the
/// largest one of the same episodes, each transformed by a random element (a randomisation test).
/// An environment that declares its irreps correctly is rejected in at most 1 of 1000 checks,
/// whatever the distributions.
///
/// The check assumes that the *distribution* of first states is symmetric (an environment that
/// always begins on one side is rejected), and that episodes, also of different environments, are
/// independent. It misses a wrong irrep that has no effect: of a component that never moves, in too
/// few episodes (some hundred are a good number), or if renaming explains everything, such as x and
/// y in a task without images.
///
/// # Errors
/// [`RlError::SymmetryViolated`] lists the means that are not zero. [`RlError::InvalidSetting`] for
/// fewer than 48 episodes, unfinished ones included. [`RlError::Environment`] if a step fails, and
/// [`RlError::NotFinite`] for infinite or NaN numbers.
pub fn check_env_symmetry(
    env: &mut dyn VectorEnv,
    group: Group,
    steps: usize,
    rng: &mut ChaCha8Rng,
) -> Result<(), RlError> {
    let spec = env.spec().clone();
    spec.check()?;
    let quantities = TestedQuantities::new(&spec, group);
    let mut episodes = quantities.run_episodes(env, steps, rng)?;
    quantities.centre(&mut episodes, group);
    let sums = |episode: &Vec<StepFeatures>| quantities.sums(episode);
    let episodes: Vec<Vec<f64>> = episodes.iter().map(sums).collect();
    let enough = episodes.len() >= MIN_EPISODES;
    let expected = "steps in which 48 episodes begin, in all environments together";
    require("steps", steps as f32, expected, enough)?;
    let norms = quantities.norms(&episodes);
    let ratios = |elements: &[D2]| quantities.ratios(&episodes, &norms, elements);
    let mut elements = vec![D2::Identity; episodes.len()];
    let observed = ratios(&elements);
    let largest = |all: &[f64]| all.iter().fold(0.0, |a: f64, &b| a.max(b.abs()));
    let worst = largest(&observed);
    let mut random = 0.0;
    for _ in 0..NUM_RANDOMISATIONS {
        elements.fill_with(|| group.elements()[rng.random_range(0..group.order())]);
        random = largest(&ratios(&elements)).max(random);
        // one random deviation as large is enough to accept
        if random > worst - ROUNDING_TOLERANCE {
            return Ok(());
        }
    }
    let violated = observed.iter().enumerate().filter(|(_, ratio)| ratio.abs() > random);
    let mut violations: Vec<SymmetryViolation> = violated
        .map(|(k, &deviation)| SymmetryViolation {
            what: quantities.name(&quantities.terms[k]),
            irrep: quantities.irrep(&quantities.terms[k]),
            mean: deviation * norms[k] / episodes.len() as f64,
            deviation: deviation.abs(),
        })
        .collect();
    violations.sort_by(|a, b| b.deviation.total_cmp(&a.deviation));
    if violations.is_empty() { Ok(()) } else { Err(RlError::SymmetryViolated { violations }) }
}

/// Returns `true` if an element of the group changes the sign of quantities of type `irrep`.
fn acts(group: Group, irrep: Irrep) -> bool {
    group.elements().iter().any(|&g| irrep.sign(g) < 0)
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
        terms.extend(features.clone().map(|i| vec![Factor::Change(i)]));
        terms.extend(features.clone().map(|i| vec![Factor::Feature(i), Factor::Reward]));
        terms.extend(actions.clone().map(|a| vec![Factor::Action(a), Factor::Reward]));
        for i in features.clone() {
            terms.extend(
                (i + 1..features.end).map(|j| vec![Factor::Feature(i), Factor::Feature(j)]),
            );
        }
        for a in actions.map(Factor::Action) {
            terms.extend(features.clone().map(|i| vec![a, Factor::Change(i)]));
            // a response that differs between the two sides
            let on_sides = |i| vec![a, Factor::Change(i), Factor::Feature(i)];
            terms.extend(features.clone().map(on_sides));
            terms.extend(features.clone().map(|i| vec![a, Factor::Feature(i), Factor::Reward]));
        }
        // only for quantities that change their sign does symmetry imply a mean of zero
        terms.retain(|term| acts(group, quantities.irrep(term)));
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

    /// Runs the environments with random actions and returns the steps of each episode, unfinished
    /// episodes included.
    fn run_episodes(
        &self,
        env: &mut dyn VectorEnv,
        steps: usize,
        rng: &mut ChaCha8Rng,
    ) -> Result<Vec<Vec<StepFeatures>>, RlError> {
        let (spec, n) = (&self.spec, self.spec.num_envs);
        let mut observations = Observations::new(spec);
        env.reset(&mut observations).map_err(RlError::Environment)?;
        observations.check_lengths(spec, n)?;
        observations.check_finite(spec).map_err(|e| e.with_step(|_| Some(0)))?;
        let mut features: Vec<_> = (0..n).map(|i| self.features_of(&observations, i)).collect();
        let mut running = vec![EpisodeStats::default(); n];
        let (mut open, mut episodes) = (vec![Vec::new(); n], Vec::new());
        let mut transition = Transition::new(spec);
        let width = spec.action_irreps.len();
        let (mut actions, zeros) = (vec![0.0; n * width], vec![0.0; width]);
        for _ in 0..steps {
            standard_normals(rng, &mut actions);
            let mut components: Vec<f64> = actions.iter().map(|&a| a.into()).collect();
            for (row, action) in actions.chunks_mut(width).zip(components.chunks_mut(width)) {
                if !spec.choices.is_empty() {
                    ActionDistribution { mean: &zeros, log_std: &[], choices: &spec.choices }
                        .sample(row);
                    action.iter_mut().zip(row).for_each(|(a, &mut one)| *a = one.into());
                    spec.change_action_basis(action);
                }
            }
            step(env, &running, &actions, &mut transition)?;
            for (i, action) in components.chunks(width).enumerate() {
                let ended = transition.outcomes[i].is_ended();
                let next = self.features_of(&transition.observations, i);
                // not the next observation, which belongs to another episode
                let after = if ended {
                    self.features_of(&transition.final_observations, i)
                } else {
                    next.clone()
                };
                open[i].push(StepFeatures {
                    change: after.iter().zip(&features[i]).map(|(a, b)| a - b).collect(),
                    before: std::mem::replace(&mut features[i], next),
                    action: action.to_vec(),
                    reward: f64::from(transition.rewards[i]),
                });
                running[i].length += 1;
                if ended {
                    episodes.push(std::mem::take(&mut open[i]));
                    running[i].length = 0;
                }
            }
        }
        episodes.extend(open.into_iter().filter(|episode| !episode.is_empty()));
        Ok(episodes)
    }

    /// Subtracts their means over all steps from the reward and from the features that no element
    /// of the group changes. These means are the same for transformed episodes, and without them
    /// products have less noise.
    fn centre(&self, episodes: &mut [Vec<StepFeatures>], group: Group) {
        let count = episodes.iter().map(Vec::len).sum::<usize>() as f64;
        let mut subtract = |number: fn(&mut StepFeatures, usize) -> &mut f64, i: usize| {
            let mut total = 0.0;
            episodes.iter_mut().flatten().for_each(|step| total += *number(step, i));
            episodes.iter_mut().flatten().for_each(|step| *number(step, i) -= total / count);
        };
        subtract(|step, _| &mut step.reward, 0);
        for (i, &irrep) in self.feature_irreps.iter().enumerate() {
            if !acts(group, irrep) {
                subtract(|step, k| &mut step.before[k], i);
            }
        }
    }

    /// Returns the sums of all tested quantities over the steps of an episode.
    fn sums(&self, episode: &[StepFeatures]) -> Vec<f64> {
        let sum = |term: &Vec<Factor>| episode.iter().map(|step| step.value(term)).sum();
        self.terms.iter().map(sum).collect()
    }

    /// Returns the features of the observation of environment `i`: the components of its vector,
    /// then the moments of its image.
    fn features_of(&self, observations: &Observations, i: usize) -> Vec<f64> {
        let (image, vector) = observations.image_and_vector(&self.spec, i);
        let [height, width, channels] = self.spec.image_shape;
        let (h, w) = (height as f64, width as f64);
        let mut moments = vec![0.0; 4 * channels];
        for (k, &byte) in image.iter().enumerate() {
            let (row, column) = (k / channels / width, k / channels % width);
            // x to the right and y up, in half pixels: whole numbers, so that sums are exact and a
            // moment that does not change has no change by rounding, either
            let (x, y) = ((2 * column + 1) as f64 - w, h - (2 * row + 1) as f64);
            let own = &mut moments[4 * (k % channels)..][..4];
            for (moment, factor) in own.iter_mut().zip([1.0, x, y, x * y]) {
                *moment += factor * f64::from(byte);
            }
        }
        let units = [1.0, w, h, w * h].map(|unit| 255.0 * w * h * unit);
        moments.iter_mut().zip(units.iter().cycle()).for_each(|(moment, unit)| *moment /= unit);
        vector.iter().map(|&v| f64::from(v)).chain(moments).collect()
    }

    /// Returns the norm of each tested quantity: the root of the sum over episodes of its squared
    /// sums, which no change of signs alters.
    fn norms(&self, episodes: &[Vec<f64>]) -> Vec<f64> {
        let squares = |k: usize| episodes.iter().map(|sums| sums[k] * sums[k]).sum::<f64>();
        (0..self.terms.len()).map(|k| squares(k).sqrt()).collect()
    }

    /// Returns the sum of each tested quantity over the episodes, each transformed by its group
    /// element, relative to the quantity's norm; 0 for a quantity that is zero throughout.
    fn ratios(&self, episodes: &[Vec<f64>], norms: &[f64], elements: &[D2]) -> Vec<f64> {
        let ratio = |(k, term): (usize, &Vec<Factor>)| {
            let irrep = self.irrep(term);
            let signed = |(sums, &g): (&Vec<f64>, &D2)| f64::from(irrep.sign(g)) * sums[k];
            let sum = episodes.iter().zip(elements).map(signed).sum::<f64>();
            if norms[k] > 0.0 { sum / norms[k] } else { 0.0 }
        };
        self.terms.iter().enumerate().map(ratio).collect()
    }
}

/// One step of one environment: the action, the reward, the features of the observation before it,
/// and their changes.
#[derive(Clone)]
struct StepFeatures {
    before: Vec<f64>,
    change: Vec<f64>,
    action: Vec<f64>,
    reward: f64,
}

impl StepFeatures {
    fn value(&self, term: &[Factor]) -> f64 {
        let values = term.iter().map(|&factor| match factor {
            Factor::Feature(i) => self.before[i],
            Factor::Change(i) => self.change[i],
            Factor::Action(a) => self.action[a],
            Factor::Reward => self.reward,
        });
        values.product()
    }
}
