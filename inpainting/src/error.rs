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
    /// Too few poses for a camera to be found by.
    #[error("the ball was seen in {got} poses, expected at least {needed}")]
    TooFewPoses {
        /// Poses in which it was seen.
        got: usize,
        /// Poses that it takes.
        needed: usize,
    },
    /// A camera that does not look at the ball as it is said to hang.
    #[error(
        "the camera that the search starts from does not see the hand of pose {pose} at all: \
         correct its place and where it looks"
    )]
    Unseen {
        /// Number of the pose.
        pose: usize,
    },
    /// A pose that does not fit the others.
    #[error(
        "the ball of pose {pose} is seen {pixels:.1} pixels from where the other poses have it, \
         expected at most {limit} pixels: look whether it moved in the hand, whether another thing \
         was taken for it, and whether intrinsics and joints are right"
    )]
    Misfit {
        /// Number of the worst pose.
        pose: usize,
        /// Its residual (pixels).
        pixels: f64,
        /// The largest one allowed (pixels).
        limit: f64,
    },
    /// A focal length that the poses contradict.
    #[error(
        "the focal lengths are given as {:.1} and {:.1} pixels, but the poses fit {:.1} and {:.1}, \
         give or take {sigma:.1}: correct the intrinsics that the rig gives (those of this size of \
         picture), and look whether joints and the lens are as they are said to be", .given[0],
        .given[1], .fitted[0], .fitted[1]
    )]
    WrongFocal {
        /// Focal lengths across and down that were given (pixels).
        given: [f64; 2],
        /// Focal lengths that fit the poses best (pixels).
        fitted: [f64; 2],
        /// One standard deviation of the first of these (pixels).
        sigma: f64,
    },
    /// Poses that fit many cameras.
    #[error("the poses do not tell where the camera is: {advice}")]
    Undetermined {
        /// What to do.
        advice: &'static str,
    },
    /// A picture without the ball.
    #[error(
        "no ball of the colour {color:?} is seen: it is hidden, smaller than {least} pixels, or \
         of another colour in this light"
    )]
    NoBall {
        /// The colour, RGB.
        color: [u8; 3],
        /// Fewest pixels of a ball.
        least: usize,
    },
    /// More than one ball.
    #[error(
        "{} things of the colour {color:?} are seen, at columns and rows {places:.0?}: take away \
         all but the ball", places.len()
    )]
    SeveralBalls {
        /// The colour, RGB.
        color: [u8; 3],
        /// Where they are (pixels).
        places: Vec<[f64; 2]>,
    },
    /// A ball that is not seen whole.
    #[error(
        "what is seen of the ball at column and row {place:.0?} is no disc: it is partly hidden, or \
         at the picture's edge"
    )]
    NoDisc {
        /// Where it is (pixels).
        place: [f64; 2],
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
    Err(InpaintingError::Length { what, got: picture.len(), expected: 3 * pixels })
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
    Err(InpaintingError::Value { name, value, expected })
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
