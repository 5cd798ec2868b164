//! A check of the irreps that an environment declares, from a first rollout.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use symmetry::{D2, Group, Irrep};

use crate::distributions::standard_normals;
use crate::env::{EnvSpec, Observations, Transition, VectorEnv};
use crate::error::{RlError, require};
use crate::rollout::{Episode, step};

/// Random moves of the episodes that the observed deviation is compared with: with all of them
/// below it, a false alarm has a probability of at most 1/1000.
const DRAWS: usize = 999;

/// Episodes that are needed: a deviation is at most the root of their number, and the largest of
/// many random ones is around 4.
const MIN_EPISODES: usize = 48;

/// Deviations that differ by less are equal.
const EQUAL: f64 = 1e-9;

/// Runs `env` for `steps` steps with random actions, and refuses it if what it shows contradicts
/// the irreps in its [`EnvSpec`], as far as `group` acts on them.
///
/// If observations, actions and rewards change under the group as declared, an episode and its
/// image under a group element are equally likely. So the mean of what changes its sign is zero:
/// of components of the vector and moments of the pictures, of products of two of these, and of
/// their products and those of the action with rewards and with changes in a step. The mean that
/// deviates most, in standard errors, is compared with those of the same episodes, each moved by a
/// random element. An environment that declares its irreps rightly is refused in at most 1 of 1000
/// checks, whatever the distributions.
///
/// The check assumes two things. The *distribution* of first states is symmetric: environments that
/// always begin on one side are refused. And episodes, also those of different environments, are
/// drawn independently. It cannot see a wrong irrep where nothing depends on it: where a component
/// never moves, where too few episodes were run (some hundred are a good number), or where a
/// renaming explains all, as x for y does in a task without pictures. Actions are standard normal
/// numbers.
///
/// # Errors
/// [`RlError::Asymmetric`] names the mean that is not zero. [`RlError::Setting`] for fewer than 48
/// episodes, counting those that had not ended. [`RlError::Environment`] when a step fails, and
/// [`RlError::NotFinite`] for numbers that are not.
pub fn check_symmetry(
    env: &mut dyn VectorEnv,
    group: Group,
    steps: usize,
    rng: &mut ChaCha8Rng,
) -> Result<(), RlError> {
    let spec = env.spec().clone();
    spec.check()?;
    let features = Features::new(&spec, group);
    let episodes = features.observe(env, steps, rng)?;
    let enough = episodes.len() >= MIN_EPISODES;
    let expected = "steps in which 48 episodes begin, in all environments together";
    require("steps", steps as f32, expected, enough)?;
    let mut elements = vec![D2::Identity; episodes.len()];
    let norms = features.norms(&episodes);
    let Some((worst, observed)) = features.largest(&episodes, &norms, &elements) else {
        return Ok(());
    };
    for _ in 0..DRAWS {
        elements.fill_with(|| group.elements()[rng.random_range(0..group.order())]);
        let moved = features.largest(&episodes, &norms, &elements);
        if moved.is_some_and(|(_, moved)| moved > observed - EQUAL) {
            return Ok(());
        }
    }
    let term = features.terms[worst];
    Err(RlError::Asymmetric {
        what: features.name(term),
        irrep: features.irrep(term),
        deviation: observed,
    })
}

/// Quantity that is compared in every step. Indices count the entries of a view and the components
/// of the action.
#[derive(Clone, Copy, Debug)]
enum Term {
    /// An entry of the view.
    View(usize),
    /// The product of two of them.
    ViewPair(usize, usize),
    /// An entry times the reward.
    ViewReward(usize),
    /// A component of the action times the change of an entry.
    ActionChange(usize, usize),
    /// A component of the action times an entry and the reward.
    ActionViewReward(usize, usize),
    /// A component of the action times the reward.
    ActionReward(usize),
}

/// All terms that change their sign under the group, of environments with these sizes.
///
/// A view of an environment is its vector and, for each channel of its picture, the moments 1, x, y
/// and xy, in the unit of a full channel.
struct Features {
    spec: EnvSpec,
    /// Irreps of a view.
    view: Vec<Irrep>,
    terms: Vec<Term>,
}

impl Features {
    fn new(spec: &EnvSpec, group: Group) -> Self {
        let moments = (0..spec.image[2]).flat_map(|_| Irrep::ALL);
        let view: Vec<Irrep> = spec.vector.iter().copied().chain(moments).collect();
        let mut features = Self { spec: spec.clone(), terms: Vec::new(), view };
        let (views, actions) = (0..features.view.len(), 0..spec.action.len());
        let mut terms: Vec<Term> = views.clone().map(Term::View).collect();
        terms.extend(views.clone().map(Term::ViewReward));
        terms.extend(actions.clone().map(Term::ActionReward));
        for i in views.clone() {
            terms.extend((i + 1..views.end).map(|j| Term::ViewPair(i, j)));
        }
        for a in actions {
            terms.extend(views.clone().map(|i| Term::ActionChange(a, i)));
            terms.extend(views.clone().map(|i| Term::ActionViewReward(a, i)));
        }
        let acts = |irrep: Irrep| group.elements().iter().any(|&g| irrep.sign(g) < 0);
        terms.retain(|&term| acts(features.irrep(term)));
        features.terms = terms;
        features
    }

    /// Returns the irrep of a term.
    fn irrep(&self, term: Term) -> Irrep {
        match term {
            Term::View(i) | Term::ViewReward(i) => self.view[i],
            Term::ViewPair(i, j) => self.view[i] * self.view[j],
            Term::ActionChange(a, i) | Term::ActionViewReward(a, i) => {
                self.spec.action[a] * self.view[i]
            }
            Term::ActionReward(a) => self.spec.action[a],
        }
    }

    /// Returns the name of a term for an error.
    fn name(&self, term: Term) -> String {
        let view = |i: usize| match i.checked_sub(self.spec.vector.len()) {
            None => format!("vector component {i} ({})", self.view[i]),
            Some(k) => format!("moment {} of channel {} of the picture", self.view[i], k / 4),
        };
        let action = |a: usize| format!("action component {a} ({})", self.spec.action[a]);
        match term {
            Term::View(i) => view(i),
            Term::ViewPair(i, j) => format!("{} times {}", view(i), view(j)),
            Term::ViewReward(i) => format!("{} times the reward", view(i)),
            Term::ActionChange(a, i) => format!("{} times the change of {}", action(a), view(i)),
            Term::ActionViewReward(a, i) => {
                format!("{} times {} times the reward", action(a), view(i))
            }
            Term::ActionReward(a) => format!("{} times the reward", action(a)),
        }
    }

    /// Runs the environments and returns the sums of all terms over each episode, also over those
    /// that had not ended.
    fn observe(
        &self,
        env: &mut dyn VectorEnv,
        steps: usize,
        rng: &mut ChaCha8Rng,
    ) -> Result<Vec<Vec<f64>>, RlError> {
        let (spec, n) = (&self.spec, self.spec.num_envs);
        let mut observations = Observations::new(spec);
        env.reset(&mut observations).map_err(RlError::Environment)?;
        observations.check(spec, n)?;
        observations.check_finite(spec).map_err(|e| e.at_step(|_| Some(0)))?;
        let mut views: Vec<_> = (0..n).map(|i| self.view_of(&observations, i)).collect();
        let mut running = vec![Episode::default(); n];
        let mut sums = vec![vec![0.0; self.terms.len()]; n];
        let mut episodes = Vec::new();
        let mut transition = Transition::new(spec);
        let mut actions = vec![0.0; n * spec.action.len()];
        for _ in 0..steps {
            standard_normals(rng, &mut actions);
            step(env, &running, &actions, &mut transition)?;
            for (i, action) in actions.chunks(spec.action.len()).enumerate() {
                let ended = transition.outcomes[i].ended();
                let next = self.view_of(&transition.observations, i);
                let after = match ended {
                    true => self.view_of(&transition.final_observations, i),
                    false => next.clone(),
                };
                let step_views = StepViews {
                    before: &views[i],
                    after: &after,
                    action,
                    reward: f64::from(transition.rewards[i]),
                };
                let terms = sums[i].iter_mut().zip(&self.terms);
                terms.for_each(|(sum, &term)| *sum += step_views.value(term));
                views[i] = next;
                running[i].length += 1;
                if ended {
                    let fresh = vec![0.0; self.terms.len()];
                    episodes.push(std::mem::replace(&mut sums[i], fresh));
                    running[i].length = 0;
                }
            }
        }
        let open = sums.into_iter().zip(&running);
        episodes.extend(open.filter(|(_, e)| e.length > 0).map(|(sums, _)| sums));
        Ok(episodes)
    }

    /// Returns the view of environment `i`.
    fn view_of(&self, observations: &Observations, i: usize) -> Vec<f64> {
        let (image, vector) = observations.sample(&self.spec, i);
        let [height, width, channels] = self.spec.image;
        let mut moments = vec![0.0; 4 * channels];
        let full = 255.0 * (height * width) as f64;
        for (k, &byte) in image.iter().enumerate() {
            let (row, column) = (k / channels / width, k / channels % width);
            let x = (2 * column + 1) as f64 / width as f64 - 1.0;
            let y = 1.0 - (2 * row + 1) as f64 / height as f64;
            let level = f64::from(byte) / full;
            let own = &mut moments[4 * (k % channels)..][..4];
            for (moment, factor) in own.iter_mut().zip([1.0, x, y, x * y]) {
                *moment += factor * level;
            }
        }
        let vector = vector.iter().map(|&v| f64::from(v));
        vector.chain(moments).collect()
    }

    /// Returns the root of the sum of squares over the episodes of each term: no move changes it.
    fn norms(&self, episodes: &[Vec<f64>]) -> Vec<f64> {
        let squares = |k: usize| episodes.iter().map(|sums| sums[k] * sums[k]).sum::<f64>();
        (0..self.terms.len()).map(|k| squares(k).sqrt()).collect()
    }

    /// Returns the term whose sum over the episodes, each moved by its element, is largest beside
    /// its norm, and that ratio; none where all are zero.
    fn largest(
        &self,
        episodes: &[Vec<f64>],
        norms: &[f64],
        elements: &[D2],
    ) -> Option<(usize, f64)> {
        let ratio = |(k, &term): (usize, &Term)| {
            let irrep = self.irrep(term);
            let moved = episodes.iter().zip(elements);
            let moved = moved.map(|(sums, &g)| f64::from(irrep.sign(g)) * sums[k]);
            (norms[k] > 0.0).then(|| (k, moved.sum::<f64>().abs() / norms[k]))
        };
        let ratios = self.terms.iter().enumerate().filter_map(ratio);
        ratios.max_by(|a, b| a.1.total_cmp(&b.1))
    }
}

/// One step of one environment.
struct StepViews<'a> {
    before: &'a [f64],
    after: &'a [f64],
    action: &'a [f32],
    reward: f64,
}

impl StepViews<'_> {
    fn value(&self, term: Term) -> f64 {
        let (before, reward) = (self.before, self.reward);
        let action = |a: usize| f64::from(self.action[a]);
        match term {
            Term::View(i) => before[i],
            Term::ViewPair(i, j) => before[i] * before[j],
            Term::ViewReward(i) => before[i] * reward,
            Term::ActionChange(a, i) => action(a) * (self.after[i] - before[i]),
            Term::ActionViewReward(a, i) => action(a) * before[i] * reward,
            Term::ActionReward(a) => action(a) * reward,
        }
    }
}
