//! Error type of this crate, and the checks that return it.

use std::fmt;
use std::hint::black_box;
use std::ops::RangeInclusive;

use equivariant::LayerError;
use symmetry::Irrep;
use thiserror::Error;

/// Error of an environment; `?` converts any `Send` and `Sync` error.
pub type BoxedEnvError = Box<dyn std::error::Error + Send + Sync + 'static>;

/// Number of bytes in a GiB.
const GIB: f64 = (1_u64 << 30) as f64;

/// Errors of building networks, collecting rollouts and updating policies.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RlError {
    /// A GPU that cannot be used or was lost.
    #[cfg(feature = "wgpu")]
    #[error(transparent)]
    Gpu(#[from] equivariant::gpu::GpuError),
    /// A policy on a GPU whose network was replaced by another one.
    #[cfg(feature = "wgpu")]
    #[error(
        "got a policy with a network of its own, expected a clone of the one that the device was \
         prepared for; make a new GpuPolicy"
    )]
    NetworkMismatch,
    /// A request for a [`SymmetryLossSettings`](crate::SymmetryLossSettings) on a GPU, where it is
    /// not available.
    #[cfg(feature = "wgpu")]
    #[error(
        "the setting `symmetry` asks for a symmetry loss, which a GPU does not compute; train on \
         the CPU, or remove the setting"
    )]
    UnsupportedOnGpu,
    /// A slice whose length does not match the expected shape.
    #[error(
        "{what}: got {got} values, expected {expected} ({shape}); allocate it with the `new` that \
         takes the same EnvSpec"
    )]
    ShapeMismatch {
        /// Name of the array whose length is wrong.
        what: &'static str,
        /// Expected shape of the array, in words.
        shape: &'static str,
        /// Number of values that the array holds.
        got: usize,
        /// Number of values that the array must hold.
        expected: usize,
    },
    /// An [`EnvSpec`](crate::EnvSpec) with a size of zero.
    #[error(
        "EnvSpec::{field} is empty; a policy needs at least one environment and one action \
         component, and images of at least one pixel and channel, or EnvSpec::NO_IMAGE"
    )]
    EmptySpec {
        /// Name of the specification's field with a size of zero.
        field: &'static str,
    },
    /// An [`EnvSpec`](crate::EnvSpec) whose choices do not fit the irreps of its actions.
    #[error(
        "EnvSpec::choices add up to {sum} for {components} action_irreps; expected equal numbers, \
         at least one choice of each action, and the irreps [Trivial], [Trivial, a] or [Trivial, \
         X, Y, XY] for choices that flips exchange"
    )]
    InvalidChoices {
        /// Sum of the numbers of choices.
        sum: usize,
        /// Number of components of an action.
        components: usize,
    },
    /// Discrete actions where only continuous ones are possible.
    #[error(
        "{what} supports only continuous actions, but EnvSpec::choices declares discrete ones; use \
         Ppo on the CPU without a symmetry loss"
    )]
    DiscreteActions {
        /// Name of the part that supports only continuous actions.
        what: &'static str,
    },
    /// A network with neither an image nor a vector as input.
    #[error(
        "the network would have neither images nor vectors as input; describe one of them in \
         EnvSpec, and use an encoder other than `blind` if there are images only"
    )]
    NoObservationInput,
    /// A setting whose value is outside its allowed range.
    #[error("{name} = {value}: expected {expected}; change it in the settings")]
    InvalidSetting {
        /// Name of the setting that is out of range.
        name: &'static str,
        /// Rejected value of the setting.
        value: f64,
        /// Allowed range of the setting, in words.
        expected: &'static str,
    },
    /// A policy that remembers its episode and was asked about single observations.
    #[error("the policy remembers its episode, so single observations have no output")]
    NeedsEpisode,
    /// A policy that cannot be exported, because ordinary layers cannot express it.
    #[error(
        "{part} has no form in ordinary layers: only policies without a context, with continuous \
         actions and with square images can be exported"
    )]
    NotExportable {
        /// Description of the part of the policy that cannot be exported.
        part: &'static str,
    },
    /// An array too large for this machine's memory.
    #[error(
        "{what} of these settings would take {:.1} GiB, more memory than is available; ask \
         for fewer or smaller ones",
        bytes / GIB
    )]
    NotEnoughMemory {
        /// Description of the arrays that would not fit in memory.
        what: &'static str,
        /// Size in bytes of the arrays that would not fit in memory.
        bytes: f64,
    },
    /// A step pushed to a full rollout buffer.
    #[error(
        "the rollout buffer already holds its {steps} steps; call `clear` before the next rollout"
    )]
    BufferFull {
        /// Number T of steps that the rollout buffer holds when full.
        steps: usize,
    },
    /// A rollout buffer read before it was full and finished.
    #[error(
        "the rollout buffer holds {got} of {steps} steps; fill it and call `finish` before an \
         update"
    )]
    BufferNotFinished {
        /// Number of steps pushed to the rollout buffer so far.
        got: usize,
        /// Number T of steps that the rollout buffer holds when full.
        steps: usize,
    },
    /// Images of a size that the encoder cannot process.
    #[error(
        "images of {height} x {width} pixels do not fit the {encoder} encoder with {halvings} \
         halvings: expected {expected}; crop or resize the images or change \
         NetworkSettings::encoder"
    )]
    UnsupportedImageSize {
        /// Height of the images in pixels.
        height: usize,
        /// Width of the images in pixels.
        width: usize,
        /// Kind of the encoder that rejects the images.
        encoder: &'static str,
        /// Number of times that the encoder halves the sides of the images.
        halvings: usize,
        /// Image sizes that the encoder accepts, in words.
        expected: String,
    },
    /// Environment, policy or experience made for different environments.
    #[error(
        "EnvSpec::{field} differs between environment, policy and experience: it is {one} and \
         {two}; build them from the same EnvSpec"
    )]
    SpecMismatch {
        /// Name of the field of [`crate::EnvSpec`] that differs between environment, policy and
        /// experience.
        field: &'static str,
        /// Value of the field in one of them.
        one: String,
        /// Value of the field in the other.
        two: String,
    },
    /// Rollouts that begin with a reset and are shorter than an episode.
    #[error(
        "rollouts of {steps} steps end before an episode of {horizon} steps does, so they never \
         reach its late states; collect at least {horizon} steps in every environment"
    )]
    ShortRollout {
        /// Number T of steps of a rollout.
        steps: usize,
        /// Number of steps of the longest possible episode.
        horizon: usize,
    },
    /// A saved state that does not fit the algorithm it is restored to.
    #[error(
        "the saved state holds: {got}; expected: {expected}; restore it to the algorithm and the \
         network that it was saved from"
    )]
    StateMismatch {
        /// Names and lengths of the arrays in the saved state.
        got: String,
        /// Names and lengths of the arrays that the algorithm expects.
        expected: String,
    },
    /// An invalid number in an algorithm's saved state.
    #[error(
        "the saved `{name}` holds {value}, expected {expected}; the file is damaged, restore an \
         older one"
    )]
    InvalidStateNumber {
        /// Name of the array or counter that holds the invalid number.
        name: String,
        /// Invalid number found in the saved state.
        value: f64,
        /// Allowed values of the invalid number, in words.
        expected: &'static str,
    },
    /// A network layer whose field types or sizes do not fit together.
    #[error(transparent)]
    Layer(Box<LayerError>),
    /// A parameter vector whose length is not that of the network's parameters.
    #[error(
        "got {got} parameters, expected {expected}; build the policy with the settings and the \
         spec that the parameters were saved with"
    )]
    ParameterCountMismatch {
        /// Number of parameters in the rejected parameter vector.
        got: usize,
        /// Number of parameters of the network.
        expected: usize,
    },
    /// A policy with a log_std below [`PpoSettings::min_log_std`](crate::PpoSettings::min_log_std).
    #[error(
        "the policy has log_std = {log_std}, below PpoSettings::min_log_std = {min_log_std}, and \
         would jump there at the first step; lower min_log_std or start with a larger \
         NetworkSettings::log_std"
    )]
    LogStdBelowMinimum {
        /// Logarithm of the policy's first standard deviation that is too small.
        log_std: f32,
        /// Smallest logarithm of a standard deviation that the PPO settings allow.
        min_log_std: f32,
    },
    /// A step whose flags report success at its end but not within the step.
    #[error(
        "environment {env} has success_at_end without success in the same step; set `success` \
         wherever the condition held at any time within the step, its end included"
    )]
    ContradictorySuccess {
        /// Index of the environment with the contradictory success flags, in 0..N.
        env: usize,
    },
    /// A step pushed to a replay buffer that does not continue the episode.
    #[error(
        "the observation of environment {env} differs from the one that its last step led to; \
         call `ReplayBuffer::cut_running_episodes` after a reset"
    )]
    EpisodeNotContinued {
        /// Index of the environment whose step does not continue its episode, in 0..N.
        env: usize,
    },
    /// An image in which a channel declared as still changed during an episode.
    #[error(
        "the last {channels} channels of the image of environment {env} differ from those at \
         the beginning of its episode; lower ReplaySettings::still_channels"
    )]
    StillChannelChanged {
        /// Index of the environment in whose image a still channel changed, in 0..N.
        env: usize,
        /// Number of image channels declared to stay the same during an episode.
        channels: usize,
    },
    /// An environment whose data contradict the irreps that it declares.
    #[error(
        "the mean of {} would be 0 by the irreps of the EnvSpec, since it changes its sign as {} \
         does, but is {:.1} standard errors away, and those of {} other quantities, too; correct \
         the irreps, or check environments whose first states are distributed symmetrically",
        violations[0].what, violations[0].irrep, violations[0].deviation, violations.len() - 1
    )]
    SymmetryViolated {
        /// Quantities that contradict their irreps, at least one, the most significant first.
        violations: Vec<SymmetryViolation>,
    },
    /// An infinite or NaN quantity.
    #[error(
        "{what} is {value}{location}, expected a finite number; check the environment's observations \
         and rewards, then lower the learning rates"
    )]
    NotFinite {
        /// Name of the quantity that is infinite or NaN.
        what: &'static str,
        /// Environment, component and step of the infinite or NaN number.
        location: InvalidNumberLocation,
        /// Infinite or NaN value of the quantity.
        value: f64,
    },
    /// An observation too large to train on.
    #[error(
        "{what} is {value:e}{location}, expected a number of order 1, at most {limit:e} in \
         magnitude; divide it by its unit in the environment"
    )]
    ObservationTooLarge {
        /// Name of the observed quantity that is too large.
        what: &'static str,
        /// Environment, component and step of the number that is too large.
        location: InvalidNumberLocation,
        /// Value of the observation's component that is too large.
        value: f32,
        /// Largest magnitude accepted for a component of an observation vector.
        limit: f32,
    },
    /// A failure of the environment.
    #[error("the environment failed: {0}")]
    Environment(#[source] BoxedEnvError),
}

/// Location in the data of a number that an error reports: environment, component and step, as far
/// as they are known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InvalidNumberLocation {
    /// Index of the environment that the number belongs to, in 0..N.
    pub env: Option<usize>,
    /// Index of the number among the components of an observation vector or an action.
    pub component: Option<usize>,
    /// Number of steps that the episode had taken: 0 for the first observation.
    pub step: Option<usize>,
}

impl fmt::Display for InvalidNumberLocation {
    /// Formats the known parts as ` (environment 1, step 3)`; nothing if none is known.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = [("environment", self.env), ("component", self.component), ("step", self.step)];
        let known = parts.iter().filter_map(|(name, index)| Some((name, (*index)?)));
        for (count, (name, index)) in known.enumerate() {
            let before = if count == 0 { " (" } else { ", " };
            write!(f, "{before}{name} {index}")?;
        }
        if *self == Self::default() { Ok(()) } else { f.write_str(")") }
    }
}

/// Quantity whose mean contradicts the declared irreps, as
/// [`check_env_symmetry`](crate::check_env_symmetry) finds it.
#[derive(Clone, Debug, PartialEq)]
pub struct SymmetryViolation {
    /// Name of the quantity: a product of components of vector and action, moments of the image,
    /// changes of these in a step, and the reward.
    pub what: String,
    /// Irrep by which the quantity would change its sign, if the declared irreps were right.
    pub irrep: Irrep,
    /// Mean over episodes of the quantity's sum over an episode, which would be 0.
    pub mean: f64,
    /// Magnitude of the mean in standard errors: its noise between episodes.
    pub deviation: f64,
}

impl RlError {
    /// Adds the `step` of an environment's episode to an error that names the environment but no
    /// step.
    pub(crate) fn with_step(mut self, step: impl Fn(usize) -> Option<usize>) -> Self {
        if let Self::NotFinite { location, .. } | Self::ObservationTooLarge { location, .. } =
            &mut self
        {
            location.step = location.step.or_else(|| location.env.and_then(step));
        }
        self
    }
}

impl From<LayerError> for RlError {
    fn from(error: LayerError) -> Self {
        Self::Layer(Box::new(error))
    }
}

/// Rejects a slice whose length is not `expected`.
pub(crate) fn check_len(
    what: &'static str,
    shape: &'static str,
    got: usize,
    expected: usize,
) -> Result<(), RlError> {
    if got == expected {
        Ok(())
    } else {
        Err(RlError::ShapeMismatch { what, shape, got, expected })
    }
}

/// Rejects a `value` that is infinite or NaN.
pub(crate) fn check_finite(what: &'static str, value: f64) -> Result<(), RlError> {
    check_finite_at(what, value, InvalidNumberLocation::default())
}

/// Rejects a `value` that is infinite or NaN, and reports its `location`.
pub(crate) fn check_finite_at(
    what: &'static str,
    value: f64,
    location: InvalidNumberLocation,
) -> Result<(), RlError> {
    if value.is_finite() { Ok(()) } else { Err(RlError::NotFinite { what, location, value }) }
}

/// Rejects the array `values` if it contains an infinity or NaN.
pub(crate) fn check_all_finite(what: &'static str, values: &[f32]) -> Result<(), RlError> {
    let wrong = values.iter().find(|value| !value.is_finite());
    wrong.map_or(Ok(()), |&value| check_finite(what, f64::from(value)))
}

/// Rejects `values` `[N, width]` with an infinity or NaN, and reports environment and component.
pub(crate) fn check_rows_finite(
    what: &'static str,
    values: &[f32],
    width: usize,
) -> Result<(), RlError> {
    let wrong = values.iter().position(|value| !value.is_finite());
    wrong.map_or(Ok(()), |index| {
        let location = InvalidNumberLocation {
            env: Some(index / width),
            component: Some(index % width),
            step: None,
        };
        check_finite_at(what, f64::from(values[index]), location)
    })
}

/// Rejects a parameter vector whose length is not that of the network's parameters.
pub(crate) fn check_params_fit_network(got: usize, expected: usize) -> Result<(), RlError> {
    if got == expected { Ok(()) } else { Err(RlError::ParameterCountMismatch { got, expected }) }
}

/// Panics if the length of a slice is not `expected`; for lengths that only a bug in the calling
/// code can get wrong.
pub(crate) fn assert_len(what: &str, got: usize, expected: usize) {
    assert!(got == expected, "{what}: got {got} values, expected {expected}");
}

/// Allowed range of settings of log_std, the logarithm of an action component's standard deviation.
/// Much below -10, actions in f32 are too coarse for their own density; above 2, noise is more than
/// seven times an action's unit.
const LOG_STD_RANGE: RangeInclusive<f32> = -10.0..=2.0;

/// Rejects the setting `name` unless its value is `allowed`.
pub(crate) fn require(
    name: &'static str,
    value: f32,
    expected: &'static str,
    allowed: bool,
) -> Result<(), RlError> {
    if allowed {
        return Ok(());
    }
    Err(RlError::InvalidSetting { name, value: f64::from(value), expected })
}

/// Rejects the number `name` of an algorithm's saved state unless its value is `allowed`.
pub(crate) fn require_saved(
    name: &str,
    value: f64,
    expected: &'static str,
    allowed: bool,
) -> Result<(), RlError> {
    if allowed {
        return Ok(());
    }
    Err(RlError::InvalidStateNumber { name: name.to_owned(), value, expected })
}

/// Maximum width of a layer, in fields or channels, that settings may ask for; a field type has at
/// most 2^24 channels.
const MAX_WIDTH: usize = 1 << 16;

/// Rejects a layer width of zero and one above [`MAX_WIDTH`].
pub(crate) fn require_width(name: &'static str, width: usize) -> Result<(), RlError> {
    let expected = "1 to 65536 (a list must not be empty)";
    require(name, width as f32, expected, (1..=MAX_WIDTH).contains(&width))
}

/// Rejects an array whose `sizes`, multiplied to bytes, exceed this machine's memory: allocating it
/// would abort the program.
pub(crate) fn require_memory(what: &'static str, sizes: &[usize]) -> Result<(), RlError> {
    let total = sizes.iter().try_fold(1_usize, |n, &size| n.checked_mul(size));
    // without the black box, the compiler removes the unused allocation
    let fits = |bytes| black_box(Vec::<u8>::new()).try_reserve_exact(bytes).is_ok();
    if total.is_some_and(fits) {
        return Ok(());
    }
    let bytes = sizes.iter().map(|&size| size as f64).product();
    Err(RlError::NotEnoughMemory { what, bytes })
}

/// Rejects a network whose parameters, gradient and moments exceed this machine's memory.
pub(crate) fn require_network_memory(num_params: usize) -> Result<(), RlError> {
    require_memory("the network", &[num_params, 4 * size_of::<f32>()])
}

/// Rejects a setting that is not a finite number above 0.
pub(crate) fn require_positive(name: &'static str, value: f32) -> Result<(), RlError> {
    let allowed = value > 0.0 && value.is_finite();
    require(name, value, "a finite number above 0", allowed)
}

/// Rejects a setting outside [0, 1].
pub(crate) fn require_share(name: &'static str, value: f32) -> Result<(), RlError> {
    let allowed = (0.0..=1.0).contains(&value);
    require(name, value, "a number in [0, 1]", allowed)
}

/// Rejects a setting that is not a finite number of at least 0.
pub(crate) fn require_weight(name: &'static str, value: f32) -> Result<(), RlError> {
    let allowed = value >= 0.0 && value.is_finite();
    require(name, value, "a finite number, at least 0", allowed)
}

/// Rejects a setting that is a count below `least`.
pub(crate) fn require_count(
    name: &'static str,
    count: usize,
    least: usize,
    expected: &'static str,
) -> Result<(), RlError> {
    require(name, count as f32, expected, count >= least)
}

/// Rejects a log_std setting outside [`LOG_STD_RANGE`].
pub(crate) fn require_log_std(name: &'static str, value: f32) -> Result<(), RlError> {
    require(name, value, "a number in [-10, 2]", LOG_STD_RANGE.contains(&value))
}
