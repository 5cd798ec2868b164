//! Checks that settings of all kinds share.

use std::hint::black_box;
use std::ops::RangeInclusive;

use crate::error::RlError;

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
    Err(RlError::Setting {
        name,
        value: f64::from(value),
        expected,
    })
}

/// The widest layer that a setting may ask for; a field type ends at 2^24 channels.
const MAX_WIDTH: usize = 1 << 16;

/// Refuses a width of zero, and one that no memory would hold.
pub(crate) fn require_width(name: &'static str, width: usize) -> Result<(), RlError> {
    let expected = "1 to 65536 (a list must not be empty)";
    require(
        name,
        width as f32,
        expected,
        (1..=MAX_WIDTH).contains(&width),
    )
}

/// Refuses an array of these sizes, in bytes, that this machine has no memory for: allocating it
/// would end the program.
pub(crate) fn require_memory(what: &'static str, sizes: &[usize]) -> Result<(), RlError> {
    let bytes = sizes
        .iter()
        .try_fold(1_usize, |n, &size| n.checked_mul(size));
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

/// Refuses what is not a logarithm of a standard deviation to begin with or to stop at.
pub(crate) fn require_log_std(name: &'static str, value: f32) -> Result<(), RlError> {
    require(
        name,
        value,
        "a number in [-10, 2]",
        LOG_STD.contains(&value),
    )
}
