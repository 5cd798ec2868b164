//! Errors of camera calibration, in-painting and perception.

use glam::DVec3;

/// Error in settings, inputs or pictures, or of a hand-eye calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InpaintingError {
    /// Setting or position outside its range.
    #[error("`{name}` is {value}, expected {expected}")]
    InvalidValue {
        /// Name of the setting or input.
        name: &'static str,
        /// Rejected value of the setting or input.
        value: String,
        /// Accepted values of the setting or input, in words.
        expected: &'static str,
    },
    /// Slice, such as a picture, of the wrong length.
    #[error("`{what}` has {got} elements, expected {expected}")]
    WrongLength {
        /// Name of the contents of the slice.
        what: &'static str,
        /// Length of the slice.
        got: usize,
        /// Length that the camera's picture size requires.
        expected: usize,
    },
    /// Camera whose picture does not show all of the required area of the table.
    #[error(
        "the camera's picture of {width} x {height} pixels does not show all of the table that is \
         needed: {}. Check the camera's position, direction and lens in its calibration, move it \
         higher or nearer to the middle, or request less of the table", shown_at(.place)
    )]
    OutOfSight {
        /// Column and row outside of the picture that are needed; `None` if the lens shows the
        /// place nowhere.
        place: Option<[f64; 2]>,
        /// Width of the picture (pixels).
        width: usize,
        /// Height of the picture (pixels).
        height: usize,
    },
    /// Too few poses of the arm for a hand-eye calibration.
    #[error("the ball was seen in {got} poses, expected at least {needed}")]
    TooFewPoses {
        /// Number of arm poses in which the ball was seen.
        got: usize,
        /// Number of arm poses that are needed.
        needed: usize,
    },
    /// Start of the search for the camera's pose from which the camera would not see the hand in
    /// some pose of the arm.
    #[error(
        "the camera that the search starts from does not see the hand of pose {pose} at all: \
         correct its position and orientation"
    )]
    HandUnseenFromStart {
        /// Number of the arm pose whose hand is not seen.
        pose: usize,
    },
    /// Arm pose that is inconsistent with the others in a hand-eye calibration.
    #[error(
        "the ball of pose {pose} is seen {pixels:.1} pixels from where the other poses predict it, \
         expected at most {limit:.1} pixels: check that it did not move in the hand, and that no \
         other object was taken for it; with more than ten poses such a one is left out"
    )]
    OutlierPose {
        /// Number of the inconsistent arm pose.
        pose: usize,
        /// Distance in the picture between the ball and where the other poses predict it (pixels).
        pixels: f64,
        /// Largest distance that counts as noise (pixels).
        limit: f64,
    },
    /// Arm poses that are inconsistent in a hand-eye calibration, whichever one is left out.
    #[error(
        "the poses contradict each other, whichever one is left out: the ball of pose {pose} is \
         {pixels:.1} pixels off, expected at most {limit:.1} for an arm that is accurate to {:.1} \
         mm (`--arm-accuracy`). {}Check that the ball's offset (`--offset`) is in millimetres and \
         along the axes of the hand, that poses of the hand are in metres in the world, that \
         columns and rows of pixels are not swapped, and that the intrinsics are those of this \
         picture size", 1e3 * accuracy, fits(.fitted)
    )]
    InconsistentPoses {
        /// Number of the worst arm pose, the one without which the others fit best.
        pose: usize,
        /// Distance in the picture between the ball of the worst pose and where the others predict
        /// it (pixels).
        pixels: f64,
        /// Largest residual that counts as noise (pixels).
        limit: f64,
        /// Standard deviation of the ball's position by the arm's joints (metres).
        accuracy: f64,
        /// Offset of the ball in the hand (metres) with which the poses fit, if the given one is
        /// wrong.
        fitted: Option<DVec3>,
    },
    /// Given focal length that the arm poses of a hand-eye calibration contradict.
    #[error(
        "the focal lengths are given as {:.1} and {:.1} pixels, but the poses fit {:.1} and {:.1}, \
         with a standard deviation of {sigma:.1}: correct the intrinsics of the rig (those of this \
         picture size), and check the joint positions and the distortion of the lens", .given[0],
        .given[1], .fitted[0], .fitted[1]
    )]
    WrongFocalLength {
        /// Given focal lengths, horizontal and vertical (pixels).
        given: [f64; 2],
        /// Focal lengths that fit the poses best (pixels).
        fitted: [f64; 2],
        /// Standard deviation of the fitted horizontal focal length (pixels).
        sigma: f64,
    },
    /// Arm poses that do not determine the pose of the camera.
    #[error("the poses do not determine where the camera is: {advice}")]
    CameraPoseUndetermined {
        /// Advice for better arm poses.
        advice: &'static str,
    },
    /// Picture in which the calibration ball is not seen.
    #[error(
        "no ball of the colour {color:?} is seen: it is hidden, smaller than {least} pixels, or \
         of another colour in this light"
    )]
    NoBall {
        /// Colour of the ball, RGB.
        color: [u8; 3],
        /// Minimum number of pixels of a ball.
        least: usize,
    },
    /// Picture with several spots of the calibration ball's colour.
    #[error(
        "{} things of the colour {color:?} are seen, at columns and rows {places:.0?}: remove all \
         but the ball", places.len()
    )]
    SeveralBalls {
        /// Colour of the ball, RGB.
        color: [u8; 3],
        /// Columns and rows of the middles of the spots (pixels).
        places: Vec<[f64; 2]>,
    },
    /// Calibration ball that is not fully visible.
    #[error(
        "the visible part of the ball at column and row {place:.0?} is no disc: the ball is partly \
         hidden, or at the picture's edge"
    )]
    BallPartlyHidden {
        /// Column and row of the visible part of the ball (pixels).
        place: [f64; 2],
    },
}

fn shown_at(place: &Option<[f64; 2]>) -> String {
    match place {
        Some([column, row]) => format!("a part would be at column {column:.0}, row {row:.0}"),
        None => "the lens shows a part nowhere".to_owned(),
    }
}

fn fits(offset: &Option<DVec3>) -> String {
    offset.as_ref().map_or_else(String::new, |&metres| {
        format!("They fit if the ball is at {:.1} mm in the hand. ", 1e3 * metres)
    })
}

/// Rejects a picture `[height, width, 3]` with another number of pixels than `pixels`.
pub(crate) fn check_picture_size(
    what: &'static str,
    picture: &[u8],
    pixels: usize,
) -> Result<(), InpaintingError> {
    if picture.len() == 3 * pixels {
        return Ok(());
    }
    Err(InpaintingError::WrongLength { what, got: picture.len(), expected: 3 * pixels })
}

/// Returns [`InpaintingError::InvalidValue`] for the input `name` unless the condition `holds`.
pub(crate) fn require_that(
    holds: bool,
    name: &'static str,
    value: &dyn ToString,
    expected: &'static str,
) -> Result<(), InpaintingError> {
    if holds {
        return Ok(());
    }
    let value = value.to_string();
    Err(InpaintingError::InvalidValue { name, value, expected })
}

/// Rejects a length (metres) that is negative or not finite.
pub(crate) fn require_nonnegative_metres(
    name: &'static str,
    length: f64,
) -> Result<(), InpaintingError> {
    let holds = length >= 0.0 && length.is_finite();
    require_that(holds, name, &length, "a length in metres")
}

/// Rejects a value that is not positive and finite.
pub(crate) fn require_positive(
    name: &'static str,
    value: f64,
    expected: &'static str,
) -> Result<(), InpaintingError> {
    require_that(value > 0.0 && value.is_finite(), name, &value, expected)
}
