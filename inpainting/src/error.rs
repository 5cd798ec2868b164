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
    /// A camera whose picture does not hold all that shall be taken from it.
    #[error(
        "the picture of {width} x {height} pixels ends before column and row {place:?}: hang the \
         camera higher or nearer to the middle, or ask for less of the table"
    )]
    OutOfSight {
        /// The place that is needed; none where the lens shows nothing there.
        place: Option<[f64; 2]>,
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
    },
}

/// Refuses a picture `[H, W, 3]` of another number of pixels.
pub(crate) fn check_picture(
    what: &'static str,
    picture: &[u8],
    pixels: usize,
) -> Result<(), InpaintingError> {
    if picture.len() == 3 * pixels {
        return Ok(());
    }
    Err(InpaintingError::Length {
        what,
        got: picture.len(),
        expected: 3 * pixels,
    })
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

/// Refuses a length (metres) that is negative or not finite.
pub(crate) fn require_length(name: &'static str, length: f64) -> Result<(), InpaintingError> {
    let holds = length >= 0.0 && length.is_finite();
    require(holds, name, &length, "a length in metres")
}

/// Refuses what is not above zero, or not finite.
pub(crate) fn require_positive(
    name: &'static str,
    value: f64,
    expected: &'static str,
) -> Result<(), InpaintingError> {
    require(value > 0.0 && value.is_finite(), name, &value, expected)
}
