//! The errors of this crate.

use std::fmt;
use std::hint::black_box;
use std::ops::RangeInclusive;

use equivariant::LayerError;
use symmetry::Irrep;
use thiserror::Error;

/// Whatever an environment fails with. `?` turns any `Send` and `Sync` error into it.
pub type BoxError = Box<dyn std::error::Error + Send + Sync + 'static>;

/// Bytes of a GiB.
const GIB: f64 = (1_u64 << 30) as f64;

/// Errors of building networks, collecting rollouts and updating policies.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RlError {
    /// A GPU cannot be used, or is lost.
    #[cfg(feature = "wgpu")]
    #[error(transparent)]
    Gpu(#[from] equivariant::gpu::GpuError),
    /// The network of a policy on a GPU was replaced by another one.
    #[cfg(feature = "wgpu")]
    #[error(
        "got a policy with a network of its own, expected a clone of the one that the device was \
         prepared for; make a new DevicePolicy"
    )]
    OtherNetwork,
    /// A [`SymmetryLoss`](crate::SymmetryLoss) on a GPU.
    #[cfg(feature = "wgpu")]
    #[error(
        "the setting `symmetry` asks for a symmetry loss, which a GPU does not compute; train on \
         the processor, or leave it out"
    )]
    UnsupportedOnGpu,
    /// A slice has another length than its shape demands.
    #[error(
        "{what}: got {got} values, expected {expected} ({shape}); allocate it with the `new` that \
         takes the same EnvSpec"
    )]
    Shape {
        /// Name of the array.
        what: &'static str,
        /// The shape that the array should have, in words.
        shape: &'static str,
        /// Number of values found.
        got: usize,
        /// Number of values required.
        expected: usize,
    },
    /// An environment describes itself with a size of zero.
    #[error(
        "EnvSpec::{field} is empty; a policy needs at least one environment and one action \
         component, and images of at least one pixel and channel, or EnvSpec::NO_IMAGE"
    )]
    EmptySpec {
        /// The offending field.
        field: &'static str,
    },
    /// Neither an image nor a vector reaches the network.
    #[error(
        "the network would see neither images nor vectors; describe one of them in EnvSpec, and \
         look at images that come alone with another encoder than `blind`"
    )]
    NothingObserved,
    /// A setting lies outside its range.
    #[error("{name} = {value}: expected {expected}; change it in the settings")]
    Setting {
        /// Name of the field.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The range allowed, in words.
        expected: &'static str,
    },
    /// A policy that other programs have no layers for.
    #[error(
        "{part} is no ordinary layer: policies with encoders `strided`, `pooled` or `blind` and \
         without a context can be written for other programs"
    )]
    NotExportable {
        /// The part.
        part: &'static str,
    },
    /// Settings ask for an array that this machine has no memory for.
    #[error(
        "{what} of these settings would take {:.1} GiB, more than this machine gives; ask for \
         fewer or smaller ones",
        bytes / GIB
    )]
    Memory {
        /// Contents of the array.
        what: &'static str,
        /// Its size in bytes.
        bytes: f64,
    },
    /// A rollout buffer of T steps was given a step more.
    #[error(
        "the rollout buffer already holds its {steps} steps; call `clear` before the next rollout"
    )]
    BufferFull {
        /// T, the number of steps that fit.
        steps: usize,
    },
    /// A rollout buffer was read before its T steps were pushed.
    #[error(
        "the rollout buffer holds {got} of {steps} steps; fill it and call `finish` before an \
         update"
    )]
    BufferNotFinished {
        /// Steps pushed so far.
        got: usize,
        /// T, the number of steps that fit.
        steps: usize,
    },
    /// The network cannot be built for these images.
    #[error(
        "images of {height} x {width} pixels do not fit the {encoder} encoder with {halvings} \
         halvings: expected {expected}; resize the images or change NetworkSettings::encoder"
    )]
    ImageSize {
        /// Height of the images in pixels.
        height: usize,
        /// Width of the images in pixels.
        width: usize,
        /// The kind of encoder.
        encoder: &'static str,
        /// Number of times that it halves the images.
        halvings: usize,
        /// The sizes that it takes, in words.
        expected: String,
    },
    /// Images that cannot be put into the middle of a square.
    #[error(
        "images of {height} x {width} pixels: expected a square, or height and width that differ \
         by an even number; crop or resize them"
    )]
    OffCentre {
        /// Height of the images in pixels.
        height: usize,
        /// Width of the images in pixels.
        width: usize,
    },
    /// Two things that work together were made for different environments.
    #[error(
        "EnvSpec::{field} differs between two things that work together; build environment, \
         policy and experience from the same EnvSpec"
    )]
    SpecMismatch {
        /// The field of [`crate::EnvSpec`] that differs.
        field: &'static str,
    },
    /// Rollouts that begin with a reset end before an episode does.
    #[error(
        "rollouts of {steps} steps end before an episode of {horizon} steps does, so nothing \
         would be learnt of its late states; collect at least {horizon} steps in every \
         environment"
    )]
    ShortRollout {
        /// T, the steps of a rollout.
        steps: usize,
        /// Steps of the longest episode.
        horizon: usize,
    },
    /// The saved state of an algorithm does not fit the one that it is restored to.
    #[error(
        "the saved state holds: {got}; expected: {expected}; restore it to the algorithm and the \
         network that it was saved from"
    )]
    State {
        /// Names and lengths of what was saved.
        got: String,
        /// Names and lengths of what is needed.
        expected: String,
    },
    /// A number of an algorithm's saved state cannot be right.
    #[error(
        "the saved `{name}` holds {value}, expected {expected}; the file is damaged, restore an \
         older one"
    )]
    Damaged {
        /// Name of the array.
        name: String,
        /// The number.
        value: f64,
        /// Values allowed, in words.
        expected: &'static str,
    },
    /// A layer refuses its types or sizes.
    #[error(transparent)]
    Layer(Box<LayerError>),
    /// A parameter vector belongs to another network.
    #[error(
        "got {got} parameters, expected {expected}; build the policy with the settings and the \
         spec that the parameters were saved with"
    )]
    Parameters {
        /// Number of parameters given.
        got: usize,
        /// Number of parameters of the network.
        expected: usize,
    },
    /// A policy explores less than the floor of its algorithm allows.
    #[error(
        "the policy has log_std = {log_std}, below PpoSettings::min_log_std = {min_log_std}, and \
         would jump there at the first step; lower min_log_std or start with a larger \
         NetworkSettings::log_std"
    )]
    BelowFloor {
        /// Logarithm of the first standard deviation that is too small.
        log_std: f32,
        /// The floor.
        min_log_std: f32,
    },
    /// An environment contradicts itself about success.
    #[error(
        "environment {env} has success_at_end without success in the same step; set `success` \
         wherever the condition held at any time within the step, its end included"
    )]
    SuccessAtEnd {
        /// Index of the environment, in 0..N.
        env: usize,
    },
    /// A replay was given a step that does not follow the one before.
    #[error(
        "the observation that environment {env} was acted on is not the one that its last step \
         led to; call `Replay::cut` after a reset"
    )]
    Discontinued {
        /// Index of the environment, in 0..N.
        env: usize,
    },
    /// A picture changes where it should stand still.
    #[error(
        "the last {channels} channels of the picture of environment {env} differ from those at \
         the beginning of its episode; lower ReplaySettings::still_channels"
    )]
    NotStill {
        /// Index of the environment, in 0..N.
        env: usize,
        /// Channels that should stand still.
        channels: usize,
    },
    /// An environment shows what the irreps that it declares rule out.
    #[error(
        "the mean of {what} would be 0 by the irreps of the EnvSpec, since it changes its sign as \
         {irrep} does, but is {deviation:.1} standard errors away; correct the irreps, or check \
         environments whose first states are distributed symmetrically"
    )]
    Asymmetric {
        /// The quantity.
        what: String,
        /// Its irrep, as declared.
        irrep: Irrep,
        /// Its mean over episodes, in standard errors.
        deviation: f64,
    },
    /// A quantity became infinite or not a number.
    #[error(
        "{what} is {value}{place}, expected a finite number; check the environment's observations \
         and rewards, then lower the learning rates"
    )]
    NotFinite {
        /// Name of the quantity.
        what: &'static str,
        /// Environment, component and step.
        place: Place,
        /// Its value.
        value: f64,
    },
    /// An observation so large that no network can learn from it.
    #[error(
        "{what} is {value:e}{place}, expected a number of order 1, at most {limit:e} in \
         magnitude; divide it by its unit in the environment"
    )]
    TooLarge {
        /// Name of the quantity.
        what: &'static str,
        /// Environment, component and step.
        place: Place,
        /// Its value.
        value: f32,
        /// The largest magnitude accepted.
        limit: f32,
    },
    /// The environment failed.
    #[error("the environment failed: {0}")]
    Environment(#[source] BoxError),
}

/// Environment, component and step of a number, as far as they are known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// Index of the environment, in 0..N.
    pub env: Option<usize>,
    /// Index of the component of a vector or an action.
    pub component: Option<usize>,
    /// Number of steps of the episode up to it: 0 for the first observation.
    pub step: Option<usize>,
}

impl fmt::Display for Place {
    /// Begins with a space unless nothing is known.
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

impl RlError {
    /// Adds the `step` in the episode of an environment to an error that names the environment and
    /// no step yet.
    pub(crate) fn at_step(mut self, step: impl Fn(usize) -> Option<usize>) -> Self {
        if let Self::NotFinite { place, .. } | Self::TooLarge { place, .. } = &mut self {
            place.step = place.step.or_else(|| place.env.and_then(step));
        }
        self
    }
}

impl From<LayerError> for RlError {
    fn from(error: LayerError) -> Self {
        Self::Layer(Box::new(error))
    }
}

/// Refuses a slice whose length is not `expected`.
pub(crate) fn check_len(
    what: &'static str,
    shape: &'static str,
    got: usize,
    expected: usize,
) -> Result<(), RlError> {
    if got == expected { Ok(()) } else { Err(RlError::Shape { what, shape, got, expected }) }
}

/// Refuses infinities and NaN.
pub(crate) fn check_finite(what: &'static str, value: f64) -> Result<(), RlError> {
    check_finite_at(what, value, Place::default())
}

/// Refuses infinities and NaN, and names the place.
pub(crate) fn check_finite_at(what: &'static str, value: f64, place: Place) -> Result<(), RlError> {
    if value.is_finite() { Ok(()) } else { Err(RlError::NotFinite { what, place, value }) }
}

/// Refuses arrays with infinities or NaN.
pub(crate) fn check_all_finite(what: &'static str, values: &[f32]) -> Result<(), RlError> {
    let wrong = values.iter().find(|value| !value.is_finite());
    wrong.map_or(Ok(()), |&value| check_finite(what, f64::from(value)))
}

/// Refuses arrays `[N, width]` with infinities or NaN, and names environment and component.
pub(crate) fn check_rows_finite(
    what: &'static str,
    values: &[f32],
    width: usize,
) -> Result<(), RlError> {
    let wrong = values.iter().position(|value| !value.is_finite());
    wrong.map_or(Ok(()), |index| {
        let place = Place { env: Some(index / width), component: Some(index % width), step: None };
        check_finite_at(what, f64::from(values[index]), place)
    })
}

/// Refuses parameters of another network.
pub(crate) fn check_params(got: usize, expected: usize) -> Result<(), RlError> {
    if got == expected { Ok(()) } else { Err(RlError::Parameters { got, expected }) }
}

/// Panics for a slice whose length is not `expected`, where a wrong one can only be a mistake in
/// the calling code.
pub(crate) fn assert_len(what: &str, got: usize, expected: usize) {
    assert!(got == expected, "{what}: got {got} values, expected {expected}");
}

/// Logarithms of standard deviations. Much below -10, actions in f32 are too coarse for their own
/// density; above 2, noise is seven times an action's unit.
const LOG_STD: RangeInclusive<f32> = -10.0..=2.0;

/// Refuses a setting that is not `allowed`.
pub(crate) fn require(
    name: &'static str,
    value: f32,
    expected: &'static str,
    allowed: bool,
) -> Result<(), RlError> {
    if allowed {
        return Ok(());
    }
    Err(RlError::Setting { name, value: f64::from(value), expected })
}

/// The widest layer that a setting may ask for; a field type ends at 2^24 channels.
const MAX_WIDTH: usize = 1 << 16;

/// Refuses a width of zero, and one that no memory would hold.
pub(crate) fn require_width(name: &'static str, width: usize) -> Result<(), RlError> {
    let expected = "1 to 65536 (a list must not be empty)";
    require(name, width as f32, expected, (1..=MAX_WIDTH).contains(&width))
}

/// Refuses an array of these sizes, in bytes, that this machine has no memory for: allocating it
/// would end the program.
pub(crate) fn require_memory(what: &'static str, sizes: &[usize]) -> Result<(), RlError> {
    let bytes = sizes.iter().try_fold(1_usize, |n, &size| n.checked_mul(size));
    // without the black box, the compiler removes an allocation that nobody uses
    let fits = |bytes| black_box(Vec::<u8>::new()).try_reserve_exact(bytes).is_ok();
    if bytes.is_some_and(fits) {
        return Ok(());
    }
    let bytes = sizes.iter().map(|&size| size as f64).product();
    Err(RlError::Memory { what, bytes })
}

/// Refuses what is not a finite number above 0.
pub(crate) fn require_positive(name: &'static str, value: f32) -> Result<(), RlError> {
    let allowed = value > 0.0 && value.is_finite();
    require(name, value, "a finite number above 0", allowed)
}

/// Refuses what is not a share.
pub(crate) fn require_share(name: &'static str, value: f32) -> Result<(), RlError> {
    let allowed = (0.0..=1.0).contains(&value);
    require(name, value, "a number in [0, 1]", allowed)
}

/// Refuses what is not a finite number of at least 0.
pub(crate) fn require_weight(name: &'static str, value: f32) -> Result<(), RlError> {
    let allowed = value >= 0.0 && value.is_finite();
    require(name, value, "a finite number, at least 0", allowed)
}

/// Refuses a count below `least`.
pub(crate) fn require_count(
    name: &'static str,
    count: usize,
    least: usize,
    expected: &'static str,
) -> Result<(), RlError> {
    require(name, count as f32, expected, count >= least)
}

/// Refuses what is not a logarithm of a standard deviation to begin with or to stop at.
pub(crate) fn require_log_std(name: &'static str, value: f32) -> Result<(), RlError> {
    require(name, value, "a number in [-10, 2]", LOG_STD.contains(&value))
}
