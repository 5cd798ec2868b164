//! Numbers that a description may hold.

use crate::error::DescriptionError;

/// Refuses a number that makes no sense.
pub(crate) fn require(
    holds: bool,
    place: impl Fn() -> String,
    what: &'static str,
    value: f64,
    expected: &'static str,
) -> Result<(), DescriptionError> {
    if holds {
        return Ok(());
    }
    Err(DescriptionError::Number {
        place: place(),
        what,
        value,
        expected,
    })
}

/// Largest number that a robot's file may hold, in any unit.
pub(crate) const LARGEST: f64 = 1e6;

/// Refuses numbers that are not finite, and immense ones.
pub(crate) fn finite(
    place: impl Fn() -> String,
    what: &'static str,
    values: &[f64],
) -> Result<(), DescriptionError> {
    let sound = |value: &f64| value.abs() <= LARGEST;
    let absurd = values.iter().find(|value| !sound(value));
    let value = absurd.copied().unwrap_or(0.0);
    let expected = "finite numbers up to 1e6";
    require(absurd.is_none(), place, what, value, expected)
}
