//! What can go wrong in this crate.

/// Error of an in-painter's settings or of what it is given.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InpaintingError {
    /// A setting, or a position, outside its range.
    #[error("`{name}` is {value}, expected {expected}")]
    Value {
        /// What was given.
        name: &'static str,
        /// Its value.
        value: String,
        /// What would be accepted.
        expected: &'static str,
    },
    /// A slice of the wrong length.
    #[error("`{what}` has {got} elements, expected {expected}")]
    Length {
        /// What the slice holds.
        what: &'static str,
        /// Its length.
        got: usize,
        /// The length that the camera asks for.
        expected: usize,
    },
}

/// Refuses a value where a condition does not hold.
pub(crate) fn require(
    holds: bool,
    name: &'static str,
    value: &dyn ToString,
    expected: &'static str,
) -> Result<(), InpaintingError> {
    if holds {
        return Ok(());
    }
    let value = value.to_string();
    Err(InpaintingError::Value {
        name,
        value,
        expected,
    })
}
