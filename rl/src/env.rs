//! The interface of vectorised environments: plain slices in and out, without tensors or tasks.

use std::fmt;
use std::ops::Range;

use equivariant::hadamard_transform;
use symmetry::{D2, Group, Irrep};

use crate::error::{
    BoxedEnvError, InvalidNumberLocation, RlError, assert_len, check_finite_at, check_len, require,
    require_memory,
};

/// Largest magnitude accepted for a component of an observation vector; components should be of
/// order 1. The value leaves a margin below 1.8e19, from which on squares overflow f32.
pub const MAX_ABS_OBSERVATION: f32 = 1e12;

/// Sizes and symmetry types of the observations and actions of a [`VectorEnv`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EnvSpec {
    /// Number N of environments that step together, at least 1.
    pub num_envs: usize,
    /// Height, width (pixels) and channels of an image, or [`EnvSpec::NO_IMAGE`]. Every channel is
    /// of trivial type: a group element moves the pixels and leaves the colours alone.
    pub image_shape: [usize; 3],
    /// Irreducible representation of every component of the observation vector, in the
    /// environment's order; length D, which is 0 for environments with images only.
    pub vector_irreps: Vec<Irrep>,
    /// Irreducible representation of every component of the action, in the environment's order;
    /// length A. For discrete actions, see [`EnvSpec::choices`].
    pub action_irreps: Vec<Irrep>,
    /// Number of choices of each discrete action, which add up to A; empty for continuous actions.
    ///
    /// A discrete action is the one-hot vector of the choice, several of them are concatenated, and
    /// [`EnvSpec::choice_indices`] reads them. A group element permutes choices. Those that it
    /// exchanges (an orbit) stand next to each other: one that stays is declared as `[Trivial]` in
    /// `action_irreps`; two that an element of sign -1 under irrep a exchanges, as left and right,
    /// as `[Trivial, a]`; four, in the order of [`D2::ALL`], as `[Trivial, X, Y, XY]`.
    pub choices: Vec<usize>,
}

impl EnvSpec {
    /// Value of [`EnvSpec::image_shape`] for environments without images.
    pub const NO_IMAGE: [usize; 3] = [0; 3];

    /// Returns the number of bytes of one image, H * W * C.
    pub fn image_len(&self) -> usize {
        self.image_shape.iter().product()
    }

    /// Returns the index of the choice in each one-hot vector of the discrete `action` `[A]`.
    ///
    /// # Panics
    /// If the action has another length, or a part that is not a one-hot vector.
    pub fn choice_indices(&self, action: &[f32]) -> Vec<usize> {
        assert_len("action", action.len(), self.action_irreps.len());
        let chosen = |part: Range<usize>| {
            let numbers = &action[part];
            let one = numbers.iter().position(|&a| a == 1.0);
            let is_one_hot = numbers.iter().filter(|&&a| a != 0.0).count() == 1;
            match one {
                Some(index) if is_one_hot => index,
                _ => panic!(
                    "the action has the part {numbers:?}, expected the one-hot vector of a choice"
                ),
            }
        };
        choice_ranges(&self.choices).map(chosen).collect()
    }

    /// Returns the ranges of the components of a discrete action whose choices the group exchanges.
    fn orbits(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        let starts = |i: &usize| self.action_irreps[*i] == Irrep::Trivial;
        let len = self.action_irreps.len();
        let starting = (0..len).filter(starts);
        let ends = (0..len).filter(starts).skip(1).chain([len]);
        starting.zip(ends).map(|(start, end)| start..end)
    }

    /// Changes the basis of a discrete action `[A]`, of its logits or of their gradient, from
    /// choices to `action_irreps` or back: the orthonormal transform is its own inverse. Continuous
    /// actions stay as they are.
    pub(crate) fn change_action_basis(&self, action: &mut [f64]) {
        if self.choices.is_empty() {
            return;
        }
        for orbit in self.orbits() {
            let group = [Group::C1, Group::D1x, Group::D2][orbit.len() / 2];
            hadamard_transform(group, &mut action[orbit]);
        }
    }

    /// Rejects discrete actions, which the algorithm named by `what` cannot take.
    pub(crate) fn require_continuous(&self, what: &'static str) -> Result<(), RlError> {
        if self.choices.is_empty() { Ok(()) } else { Err(RlError::DiscreteActions { what }) }
    }

    /// Checks that the orbits of discrete actions are well-formed and do not span two of them.
    fn check_choices(&self) -> Result<(), RlError> {
        if self.choices.is_empty() {
            return Ok(());
        }
        let irreps = &self.action_irreps;
        let sum = self.choices.iter().sum::<usize>();
        let starts = |part: Range<usize>| part.is_empty() || irreps[part.start] == Irrep::Trivial;
        let fits = |orbit: Range<usize>| orbit.len() <= 2 || irreps[orbit] == Irrep::ALL;
        let right = sum == irreps.len()
            && self.choices.iter().all(|&choices| choices > 0)
            && choice_ranges(&self.choices).all(starts)
            && self.orbits().all(fits);
        if right { Ok(()) } else { Err(RlError::InvalidChoices { sum, components: irreps.len() }) }
    }

    /// Checks that environments, actions and images, if there are any, have no size of zero, that
    /// an image, a vector or both are observed, and that choices fit the irreps of actions.
    ///
    /// # Errors
    /// [`RlError::EmptySpec`] names the field, [`RlError::NoObservationInput`] means that there are
    /// neither images nor vectors, [`RlError::InvalidChoices`] that choices do not fit.
    pub fn check(&self) -> Result<(), RlError> {
        let no_image = self.image_shape == Self::NO_IMAGE;
        // an image with some empty dimension is an error, but none at all is allowed
        let sizes = [
            ("num_envs", self.num_envs),
            ("image_shape", self.image_len() + usize::from(no_image)),
            ("action_irreps", self.action_irreps.len()),
        ];
        match sizes.iter().find(|(_, size)| *size == 0) {
            Some(&(field, _)) => Err(RlError::EmptySpec { field }),
            None if no_image && self.vector_irreps.is_empty() => Err(RlError::NoObservationInput),
            None => self.check_choices(),
        }
    }

    /// Checks that rollouts of `steps` steps of every environment fit in this machine's memory.
    ///
    /// # Errors
    /// Errors of [`EnvSpec::check`], [`RlError::InvalidSetting`] for 0 steps, and
    /// [`RlError::NotEnoughMemory`] if observations and actions exceed the machine's memory.
    pub fn check_rollout_memory(&self, steps: usize) -> Result<(), RlError> {
        self.check()?;
        require("steps", steps as f32, "at least 1 step", steps > 0)?;
        let sample = self.image_len()
            + size_of::<f32>() * (self.vector_irreps.len() + self.action_irreps.len());
        require_memory("the rollouts", &[self.num_envs, steps, sample])
    }

    /// Rejects an `other` spec with another image shape, other irreps of vector or action, or other
    /// choices; the number of environments may differ.
    ///
    /// # Errors
    /// [`RlError::SpecMismatch`] names the field.
    pub fn check_compatible(&self, other: &Self) -> Result<(), RlError> {
        check_equal("image_shape", &self.image_shape, &other.image_shape)?;
        check_equal("vector_irreps", &self.vector_irreps, &other.vector_irreps)?;
        check_equal("action_irreps", &self.action_irreps, &other.action_irreps)?;
        check_equal("choices", &self.choices, &other.choices)
    }
}

/// Rejects two values of a field of [`EnvSpec`] that differ.
fn check_equal<T: PartialEq + fmt::Debug>(
    field: &'static str,
    one: &T,
    two: &T,
) -> Result<(), RlError> {
    if one == two {
        return Ok(());
    }
    Err(RlError::SpecMismatch { field, one: format!("{one:?}"), two: format!("{two:?}") })
}

/// Returns the range that each discrete action's one-hot vector takes up in an action vector, from
/// the numbers of choices.
pub(crate) fn choice_ranges(choices: &[usize]) -> impl Iterator<Item = Range<usize>> + '_ {
    choices.iter().scan(0, |end, &len| {
        *end += len;
        Some(*end - len..*end)
    })
}

/// N observations, images and vectors: usually one of each of N environments. `Debug` prints only
/// the length of the images.
#[derive(Clone, PartialEq)]
pub struct Observations {
    /// Pixels `[N, H, W, C]` in 0..=255; pixel row 0 lies at the largest y, pixel column 0 at the
    /// smallest x.
    pub images: Vec<u8>,
    /// Observation vectors `[N, D]` with components in the environment's order. Their magnitudes
    /// should be of order 1, and each is at most [`MAX_ABS_OBSERVATION`].
    pub vectors: Vec<f32>,
}

impl Observations {
    /// Creates observations of zeros for the environments of `spec`.
    pub fn new(spec: &EnvSpec) -> Self {
        Self {
            images: vec![0; spec.num_envs * spec.image_len()],
            vectors: vec![0.0; spec.num_envs * spec.vector_irreps.len()],
        }
    }

    /// Creates an empty set of observations.
    pub(crate) fn empty() -> Self {
        Self { images: Vec::new(), vectors: Vec::new() }
    }

    /// Checks that images and vectors hold `samples` observations of the sizes in `spec`.
    ///
    /// # Errors
    /// [`RlError::ShapeMismatch`] names the array, what it holds and what it should hold.
    pub fn check_lengths(&self, spec: &EnvSpec, samples: usize) -> Result<(), RlError> {
        check_len("images", "[N, H, W, C]", self.images.len(), samples * spec.image_len())?;
        check_len("vectors", "[N, D]", self.vectors.len(), samples * spec.vector_irreps.len())
    }

    /// Returns the number N of observations if images and vectors both hold N, of the sizes in
    /// `spec`.
    pub(crate) fn checked_num_samples(&self, spec: &EnvSpec) -> Result<usize, RlError> {
        let samples = match spec.vector_irreps.len() {
            0 => self.images.len() / spec.image_len().max(1),
            width => self.vectors.len() / width,
        };
        self.check_lengths(spec, samples)?;
        Ok(samples)
    }

    /// Transforms image and vector of observation `i` by the group element `g`.
    pub(crate) fn transform(&mut self, spec: &EnvSpec, i: usize, g: D2) {
        let (image, vector) = self.image_and_vector(spec, i);
        let (image, vector) =
            (transform_image(g, image, spec), transform_vector(g, vector, &spec.vector_irreps));
        self.images[i * image.len()..(i + 1) * image.len()].copy_from_slice(&image);
        self.vectors[i * vector.len()..(i + 1) * vector.len()].copy_from_slice(&vector);
    }

    /// Rejects observation vectors with infinities, NaN or numbers beyond [`MAX_ABS_OBSERVATION`].
    ///
    /// # Errors
    /// [`RlError::NotFinite`] or [`RlError::ObservationTooLarge`] with the value, environment and
    /// component.
    pub fn check_finite(&self, spec: &EnvSpec) -> Result<(), RlError> {
        let width = spec.vector_irreps.len().max(1);
        self.vectors.chunks(width).enumerate().try_for_each(|(env, row)| {
            check_vector("a component of an observation vector", env, row)
        })
    }

    /// Returns the image `[H, W, C]` and the vector `[D]` of observation `i`.
    ///
    /// # Panics
    /// If there is no observation `i`.
    pub fn image_and_vector(&self, spec: &EnvSpec, i: usize) -> (&[u8], &[f32]) {
        let (image, vector) = (spec.image_len(), spec.vector_irreps.len());
        (&self.images[i * image..(i + 1) * image], &self.vectors[i * vector..(i + 1) * vector])
    }
}

impl fmt::Debug for Observations {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Observations")
            .field("images", &format_args!("{} bytes", self.images.len()))
            .field("vectors", &self.vectors)
            .finish()
    }
}

/// Rejects `row`, the observation vector of environment `env`, if a component is not finite, or
/// beyond [`MAX_ABS_OBSERVATION`].
fn check_vector(what: &'static str, env: usize, row: &[f32]) -> Result<(), RlError> {
    // a comparison with NaN is false, so NaN is not accepted either
    let accepted = |x: &f32| x.abs() <= MAX_ABS_OBSERVATION;
    let wrong = row.iter().position(|x| !accepted(x));
    let Some(component) = wrong else {
        return Ok(());
    };
    let location = InvalidNumberLocation { env: Some(env), component: Some(component), step: None };
    let value = row[component];
    check_finite_at(what, f64::from(value), location)?;
    Err(RlError::ObservationTooLarge { what, location, value, limit: MAX_ABS_OBSERVATION })
}

fn check_rewards(rewards: &[f32]) -> Result<(), RlError> {
    let wrong = rewards.iter().position(|reward| !reward.is_finite());
    wrong.map_or(Ok(()), |env| {
        let location = InvalidNumberLocation { env: Some(env), ..InvalidNumberLocation::default() };
        check_finite_at("a reward", f64::from(rewards[env]), location)
    })
}

/// Returns `image` `[H, W, C]`, of the sizes in `spec`, transformed by the group element `g`.
pub(crate) fn transform_image(g: D2, image: &[u8], spec: &EnvSpec) -> Vec<u8> {
    let [height, width, channels] = spec.image_shape;
    if image.is_empty() {
        return Vec::new();
    }
    g.transform_image(image, height, width, channels)
}

/// Returns the components of a vector, in the environment's order, transformed by the group element
/// `g`: each times the sign that its irrep gives to `g`.
pub(crate) fn transform_vector(g: D2, components: &[f32], irreps: &[Irrep]) -> Vec<f32> {
    let signs = irreps.iter().map(|irrep| f32::from(irrep.sign(g)));
    components.iter().zip(signs).map(|(c, s)| c * s).collect()
}

/// State of an episode after a step: running, ended by its task, or ended by a time limit. After a
/// termination, no reward follows. A truncation only stops the episode at its time limit, so the
/// value of the final observation is bootstrapped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum StepOutcome {
    /// Running episode, which goes on after the step.
    #[default]
    Running,
    /// End of the episode by its task: the value of the next state is zero.
    Terminated,
    /// End of the episode by a time limit: the value of the next state is that of the final
    /// observation.
    Truncated,
}

impl StepOutcome {
    /// Returns `true` if the episode has ended, by its task or by a time limit.
    pub fn is_ended(self) -> bool {
        self != Self::Running
    }
}

/// Result of one step of N environments.
#[derive(Clone, Debug, PartialEq)]
pub struct Transition {
    /// Observations after the step; where an episode ended, the first observation of the next
    /// episode.
    pub observations: Observations,
    /// Last observations of the episodes that ended in the step; those of running episodes have no
    /// meaning.
    pub final_observations: Observations,
    /// Reward of the step in each environment, `[N]`.
    pub rewards: Vec<f32>,
    /// State of each environment's episode after the step, `[N]`.
    pub outcomes: Vec<StepOutcome>,
    /// `true` if the success condition held at any time within this step, its end included, `[N]`.
    /// A step may be several control steps of a simulation.
    pub success: Vec<bool>,
    /// `true` if the success condition holds at the end of this step (in the final state of an
    /// ended episode), `[N]`. Implies `success`.
    pub success_at_end: Vec<bool>,
}

impl Transition {
    /// Creates a transition of running episodes with zero rewards and observations and without
    /// success.
    pub fn new(spec: &EnvSpec) -> Self {
        Self {
            observations: Observations::new(spec),
            final_observations: Observations::new(spec),
            rewards: vec![0.0; spec.num_envs],
            outcomes: vec![StepOutcome::Running; spec.num_envs],
            success: vec![false; spec.num_envs],
            success_at_end: vec![false; spec.num_envs],
        }
    }

    /// Checks the shapes of the transition against `spec`, and rejects invalid numbers, except in
    /// the final observations of running episodes.
    ///
    /// # Errors
    /// [`RlError::ShapeMismatch`] names the first array that does not fit, [`RlError::NotFinite`]
    /// the first quantity that is infinite or NaN, [`RlError::ContradictorySuccess`] the first
    /// environment with `success_at_end` but not `success`.
    pub fn check(&self, spec: &EnvSpec) -> Result<(), RlError> {
        let n = spec.num_envs;
        self.observations.check_lengths(spec, n)?;
        self.final_observations.check_lengths(spec, n)?;
        check_len("rewards", "[N]", self.rewards.len(), n)?;
        check_len("outcomes", "[N]", self.outcomes.len(), n)?;
        check_len("success", "[N]", self.success.len(), n)?;
        check_len("success_at_end", "[N]", self.success_at_end.len(), n)?;
        self.check_success()?;
        check_rewards(&self.rewards)?;
        // an ended episode's next observation is at step 0; the caller knows the step of the others
        let first = |env: usize| self.outcomes[env].is_ended().then_some(0);
        self.observations.check_finite(spec).map_err(|error| error.with_step(first))?;
        self.check_finals_finite(spec)
    }

    fn check_success(&self) -> Result<(), RlError> {
        let mut pairs = self.success.iter().zip(&self.success_at_end);
        match pairs.position(|(within, at_end)| *at_end && !within) {
            Some(env) => Err(RlError::ContradictorySuccess { env }),
            None => Ok(()),
        }
    }

    /// Rejects invalid numbers in the final observation vectors of ended episodes; those of running
    /// episodes have no meaning.
    fn check_finals_finite(&self, spec: &EnvSpec) -> Result<(), RlError> {
        let width = spec.vector_irreps.len().max(1);
        let finals = self.final_observations.vectors.chunks(width);
        let ended = self.outcomes.iter().zip(finals).enumerate();
        ended.filter(|(_, (outcome, _))| outcome.is_ended()).try_for_each(|(env, (_, row))| {
            check_vector("a component of a final observation vector", env, row)
        })
    }
}

/// N vectorised environments that step together and restart by themselves (auto-reset).
pub trait VectorEnv {
    /// Returns the number of environments and the sizes and symmetry types of their observations
    /// and actions, constant for the life of the environment.
    fn spec(&self) -> &EnvSpec;

    /// Returns the maximum number of steps of an episode; `None` without a time limit.
    fn horizon(&self) -> Option<usize> {
        None
    }

    /// Starts an episode in every environment and writes the first observations to `out`.
    ///
    /// # Errors
    /// Any failure of the environment.
    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError>;

    /// Runs one step of all N environments with the actions `[N, A]`, components in the
    /// environment's order, and writes every field of `out`. Actions may be any finite numbers,
    /// since those of a Gaussian policy are not clipped: an environment with bounds clips them
    /// itself.
    ///
    /// Scale rewards so that an episode returns a number of order 1, between 1e-2 and 1e3, or wrap
    /// the environments in a [`NormalisedEnv`](crate::NormalisedEnv): PPO with its default settings
    /// does not improve with rewards of 1e-6 and keeps exploring with rewards of 1e6.
    /// [`RolloutStats::reward_warning`](crate::RolloutStats::reward_warning) warns of other
    /// returns.
    ///
    /// # Errors
    /// Any failure of the environment.
    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError>;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec() -> EnvSpec {
        EnvSpec {
            num_envs: 3,
            image_shape: [4, 4, 2],
            vector_irreps: vec![Irrep::X, Irrep::Y],
            action_irreps: vec![Irrep::X],
            choices: vec![],
        }
    }

    /// What holds at the end of a step held within it.
    #[test]
    fn success_at_the_end_without_success_is_refused() {
        let mut transition = Transition::new(&spec());
        transition.success[1] = true;
        assert!(transition.check(&spec()).is_ok());
        transition.success_at_end[1] = true;
        assert!(transition.check(&spec()).is_ok());
        transition.success_at_end[2] = true;
        let message = transition.check(&spec()).unwrap_err().to_string();
        assert!(message.starts_with("environment 2"), "{message}");
    }

    #[test]
    fn pictures_are_not_printed() {
        let printed = format!("{:?}", Transition::new(&spec()));
        assert!(printed.contains("96 bytes") && printed.len() < 500, "{printed}");
    }

    #[test]
    fn an_empty_spec_is_refused() {
        let empty = EnvSpec { action_irreps: vec![], ..spec() };
        assert!(matches!(empty.check(), Err(RlError::EmptySpec { field: "action_irreps" })));
        let mut partial = spec();
        partial.image_shape[2] = 0;
        assert!(matches!(partial.check(), Err(RlError::EmptySpec { field: "image_shape" })));
        assert!(spec().check().is_ok());
    }
}
