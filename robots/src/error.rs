//! Errors of reading and controlling a robot.

use std::error::Error;
use std::fmt::{self, Arguments};
use std::ops::RangeInclusive;
use std::path::PathBuf;

use glam::DVec3;

/// Error in a robot's file, or in a request for a part of a robot.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DescriptionError {
    /// The file cannot be read.
    #[error("cannot read `{}`: {source}", .path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A file of a robot's settings that is no JSON, or has other fields than those settings.
    #[error("the settings of the robot in `{}` cannot be used: {message}", .path.display())]
    InvalidSettings {
        /// Path of the file.
        path: PathBuf,
        /// Line and cause.
        message: String,
    },
    /// A file that is too long.
    #[error("the URDF has more than {limit} bytes; give one robot, without meshes inside")]
    FileTooLong {
        /// Maximum number of bytes.
        limit: usize,
    },
    /// A file that is not XML, or not a URDF.
    #[error("the URDF cannot be parsed: {message}")]
    InvalidSyntax {
        /// Line and cause.
        message: String,
    },
    /// An error at a line of the file.
    #[error("line {line}: {error}")]
    Line {
        /// Line number in the file, from 1.
        line: usize,
        /// Error, which names the element.
        error: Box<DescriptionError>,
    },
    /// Error in the contents of a file, with the file's path.
    #[error("`{}`: {error}", .path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error in its contents.
        error: Box<DescriptionError>,
    },
    /// Several errors.
    #[error(
        "{} errors:{}", .errors.len(),
        .errors.iter().map(|error| format!("\n{error}")).collect::<String>()
    )]
    Several {
        /// Errors in the order in which they were found.
        errors: Vec<DescriptionError>,
    },
    /// A missing element or attribute, or one that cannot be used.
    #[error("{place} {problem}")]
    InvalidElement {
        /// Element or attribute, and the link or joint that it belongs to.
        place: String,
        /// Value in the file, and what is expected.
        problem: String,
    },
    /// A template that `xacro` has not expanded, so that parts of the robot are missing.
    #[error(
        "line {line}: {found} is xacro, not URDF: run `xacro FILE > arm.urdf` and read `arm.urdf`"
    )]
    Xacro {
        /// Line number in the file, from 1.
        line: usize,
        /// Element, or attribute with its value.
        found: String,
    },
    /// No links, or too many links, joints or shapes.
    #[error("{place} has {count} {kind}s, expected {least} to {limit}")]
    CountOutOfRange {
        /// Robot, or one of its links.
        place: String,
        /// `link`, `joint` or `collision shape`.
        kind: &'static str,
        /// Number found: of the file, or with the link that is added.
        count: usize,
        /// Minimum number.
        least: usize,
        /// Maximum number.
        limit: usize,
    },
    /// A name that cannot be used.
    #[error("the {kind} name {name:?} cannot be used: {reason}")]
    InvalidName {
        /// `link`, `joint` or `robot`.
        kind: &'static str,
        /// Rejected name, cut to 200 characters.
        name: String,
        /// Reason for the rejection.
        reason: &'static str,
    },
    /// A name that two links or two joints share.
    #[error("two {kind}s are called `{name}`; names must be unique")]
    Duplicate {
        /// `link` or `joint`.
        kind: &'static str,
        /// Shared name.
        name: String,
    },
    /// A link that does not exist.
    #[error("there is no link `{link}`, which {requested_by} names; known: {}", .known.join(", "))]
    UnknownLink {
        /// Requested name.
        link: String,
        /// Origin of the request, for instance a joint.
        requested_by: String,
        /// Names of all links.
        known: Vec<String>,
    },
    /// A hand with links that move, which are not two fingers.
    #[error(
        "the links {} move on the hand `{hand}`, and are not recognised as two fingers that one \
         joint moves: set `fingers` or `hand` in a JSON file of the arm's settings, or let one \
         finger follow the other (`<mimic>`)",
        .branches.join(", ")
    )]
    UnknownFingers {
        /// Name of the hand's link.
        hand: String,
        /// Names of the first links of its branches that move.
        branches: Vec<String>,
    },
    /// A link that is the child of two joints.
    #[error(
        "the link `{link}` is the child of the joints `{}` and `{}`; a link hangs on one joint",
        .joints[0], .joints[1]
    )]
    SeveralParents {
        /// Name of the link.
        link: String,
        /// Names of the joints.
        joints: [String; 2],
    },
    /// More than one link without a parent.
    #[error("no joint carries the links {}; a robot has one root", .roots.join(", "))]
    SeveralRoots {
        /// Names of the links.
        roots: Vec<String>,
    },
    /// A cycle of links and joints.
    #[error("the link `{link}` hangs on itself through its joints; links must form a tree")]
    Cycle {
        /// Name of a link in the cycle or below it.
        link: String,
    },
    /// A number out of range.
    #[error("{place}: {what} is {value}, expected {expected}")]
    NumberOutOfRange {
        /// Link or joint that has the number.
        place: String,
        /// Name of the quantity.
        what: &'static str,
        /// Value found.
        value: f64,
        /// Range or property expected.
        expected: &'static str,
    },
    /// A moving link without mass, in a use that needs it.
    #[error(
        "the joint `{joint}` moves the link `{link}`, which has no mass (a milligram or more), nor \
         have links that are fixed to it: give it `<inertial>`, or set `repair` in the robot's \
         settings (`UrdfSettings`, or a JSON file)"
    )]
    MissingInertia {
        /// Name of the link.
        link: String,
        /// Name of the joint.
        joint: String,
    },
    /// An inertia that no rigid body can have.
    #[error(
        "the link `{link}` has an inertia that no rigid body can have: {reason} (ixx {}, iyy {}, \
         izz {}, ixy {}, ixz {}, iyz {} kg m^2); correct it; \
         that of a robot's file is replaced with `repair` in its settings",
        .tensor[0], .tensor[1], .tensor[2], .tensor[3], .tensor[4], .tensor[5]
    )]
    InvalidInertia {
        /// Name of the link.
        link: String,
        /// Components ixx, iyy, izz, ixy, ixz, iyz (kg m^2) along the link's axes.
        tensor: [f64; 6],
        /// Violated condition.
        reason: &'static str,
    },
    /// A `<mimic>` of a joint that cannot be followed.
    #[error("the joint `{joint}` cannot follow `{followed}`: {reason}; correct its `<mimic>`")]
    InvalidMimic {
        /// Name of the joint.
        joint: String,
        /// Name of the joint in `<mimic>`.
        followed: String,
        /// Reason for the rejection.
        reason: &'static str,
    },
    /// Collision shapes that are missing, in a use that needs all shapes.
    #[error(
        "{}\ncorrect them, or set in the robot's settings (`UrdfSettings`, or a JSON file) \
         `ignore_meshes`, which leaves out all meshes, or `repair`, which enlarges sizes to 1e-6 m",
        .shapes.join("\n")
    )]
    MissingShapes {
        /// Lines, elements and reasons.
        shapes: Vec<String>,
    },
    /// A folder of the settings that does not exist.
    #[error("`{setting}` is `{}`, which is not a folder; give one that exists", .folder.display())]
    InvalidFolder {
        /// Name of the setting.
        setting: String,
        /// Path in the settings.
        folder: PathBuf,
    },
    /// Joints without maximum force or torque, which servos need.
    #[error(
        "servos need the efforts of the joints {}: state an `effort` from 1e-6 to 1e6 in their \
         `<limit>`, or set `default_effort` in the settings (`UrdfSettings`, or a JSON file)",
        .joints.join(", ")
    )]
    MissingEffort {
        /// Names of the joints.
        joints: Vec<String>,
    },
    /// A branch of more links than MuJoCo can read.
    #[error(
        "the link `{link}` hangs on {limit} others in a row, and MuJoCo 2.2.2 reads at most \
         {limit} links in a row: merge links that are fixed to each other"
    )]
    TooManyLinksInRow {
        /// Name of the first link that is too far from the root.
        link: String,
        /// Maximum number of links in a row, including the root.
        limit: usize,
    },
    /// A chain that cannot be controlled.
    #[error("the chain to the link `{tip}` cannot be controlled: {reason}")]
    InvalidChain {
        /// Name of the link at the end of the chain.
        tip: String,
        /// Reason for the rejection.
        reason: String,
    },
}

/// Error in a command to an arm, or failure of the arm. The arm stands still then, except after
/// [`ControlError::NotStopped`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ControlError {
    /// A command, or its solution, with a number that is not finite.
    #[error("{what} is {value}, expected finite numbers; the arm is stopped")]
    NotFinite {
        /// Quantity that the number is part of.
        what: &'static str,
        /// Value of that quantity.
        value: String,
    },
    /// A setting out of range.
    #[error("{name} is {value}, expected {expected}")]
    InvalidSetting {
        /// Name of the setting.
        name: &'static str,
        /// Value of the setting.
        value: String,
        /// Range expected.
        expected: &'static str,
    },
    /// Joints without maximum speed.
    #[error(
        "control needs the speeds of the joints {}: state a `velocity` from 1e-6 to 1e6 in their \
         `<limit>`, or set `default_speed` in the settings (`UrdfSettings`, or a JSON file)",
        .joints.join(", ")
    )]
    MissingSpeed {
        /// Names of the joints.
        joints: Vec<String>,
    },
    /// A joint whose lower limit is above its upper one.
    #[error(
        "the joint `{joint}` has the limits {} to {}, expected the lower one first: exchange \
         `lower` and `upper` in its `<limit>`",
        .range[0], .range[1]
    )]
    ReversedRange {
        /// Name of the joint.
        joint: String,
        /// Range in the file.
        range: [f64; 2],
    },
    /// A posture with a joint outside of its range.
    #[error(
        "the joint `{joint}` is at {position}, outside of its range {} to {}",
        .range[0], .range[1]
    )]
    JointOutOfRange {
        /// Name of the joint.
        joint: String,
        /// Position of the joint (metres or radians).
        position: f64,
        /// Range of the joint.
        range: [f64; 2],
    },
    /// A motion that the arm cannot follow any further from its present posture.
    #[error("the arm cannot follow to {miss}")]
    CannotFollow {
        /// Target, and the pose that was reached.
        miss: MissedTarget,
    },
    /// A target beyond the length of the arm.
    #[error(
        "the arm cannot reach {target} in any posture: its {part} would be {distance:.4} m from the \
         base of its chain, and its links allow at most {reach:.4} m"
    )]
    OutOfReach {
        /// Target position of the tip (metres, world).
        target: DVec3,
        /// Part of the arm that is too far away: its tip, or its last joint, whose position follows
        /// from a full pose.
        part: &'static str,
        /// Distance of that part from the base of the chain (metres).
        distance: f64,
        /// Bound on that distance in any configuration: the sum of the links' lengths (metres).
        reach: f64,
    },
    /// A target for which inverse kinematics found no configuration. There may be one.
    #[error(
        "no configuration was found that brings the tip to {miss}. That is the best of {searches} \
         searches; one from another seed, more searches, or a freer orientation may succeed"
    )]
    NoSolution {
        /// Target, and the nearest pose that was reached.
        miss: MissedTarget,
        /// Number of searches.
        searches: usize,
    },
    /// A failure of the robot, or of the connection to it.
    #[error("the robot failed: {source}")]
    Driver {
        /// Error of the robot's driver.
        source: Box<dyn Error + Send + Sync>,
    },
    /// A failed attempt to stop the arm, which may still be moving.
    #[error("{cause}; AND THE ARM COULD NOT BE STOPPED: {source}")]
    NotStopped {
        /// Reason for the stop.
        cause: String,
        /// Error of the attempt.
        source: Box<ControlError>,
    },
}

/// Target that the tip of an arm missed, and the pose that it reached instead.
#[derive(Clone, Debug, PartialEq)]
pub struct MissedTarget {
    /// Target position of the tip (metres, world).
    pub target: DVec3,
    /// Position of the tip that was reached (metres, world).
    pub reached: DVec3,
    /// Distance between `target` and `reached` (metres).
    pub distance: f64,
    /// Angle (radians) between the tip's orientation and the target's, without rotation that is
    /// free.
    pub angle: f64,
    /// A joint at the end of its range, if that is what stops the arm.
    pub joint: Option<String>,
}

impl fmt::Display for MissedTarget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { target, reached, distance, angle, joint } = self;
        write!(f, "{target}: it comes to {reached}, {distance} m and {angle} rad away")?;
        match joint {
            Some(joint) => write!(f, "; the joint `{joint}` is at the end of its range"),
            None => Ok(()),
        }
    }
}

/// Returns a single error as it is, several as one [`DescriptionError::Several`], and `Ok` without
/// errors.
pub(crate) fn all(mut errors: Vec<DescriptionError>) -> Result<(), DescriptionError> {
    match errors.len() {
        0 => Ok(()),
        1 => Err(errors.remove(0)),
        _ => Err(DescriptionError::Several { errors }),
    }
}

/// Returns [`ControlError::NotFinite`] for the quantity `what` unless `holds`.
pub(crate) fn require_finite(
    holds: bool,
    what: &'static str,
    value: Arguments<'_>,
) -> Result<(), ControlError> {
    if holds {
        return Ok(());
    }
    let value = value.to_string();
    Err(ControlError::NotFinite { what, value })
}

/// Returns [`DescriptionError::NumberOutOfRange`] for the quantity `what` unless `holds`.
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
    Err(DescriptionError::NumberOutOfRange { place: place(), what, value, expected })
}

/// Returns [`DescriptionError::CountOutOfRange`] unless `count` is in `range`.
pub(crate) fn require_count(
    place: impl Fn() -> String,
    kind: &'static str,
    count: usize,
    range: RangeInclusive<usize>,
) -> Result<(), DescriptionError> {
    if range.contains(&count) {
        return Ok(());
    }
    let (least, limit) = range.into_inner();
    Err(DescriptionError::CountOutOfRange { place: place(), kind, count, least, limit })
}

/// Largest number accepted in a robot's file, in any unit: larger ones are taken for mistakes.
pub(crate) const MAX_NUMBER: f64 = 1e6;

/// Returns `true` for a number that is finite and at most [`MAX_NUMBER`] in magnitude.
pub(crate) fn is_bounded(number: f64) -> bool {
    // a comparison that is false for NaN, too
    number.abs() <= MAX_NUMBER
}

/// Returns `true` for a number from zero to [`MAX_NUMBER`].
pub(crate) fn is_bounded_from_zero(number: f64) -> bool {
    (0.0..=MAX_NUMBER).contains(&number)
}

/// Numbers for which [`is_bounded_from_zero`] holds, as an error states them.
pub(crate) const FROM_ZERO: &str = "zero or more, up to 1e6";

/// Rejects numbers that are not finite or exceed [`MAX_NUMBER`] in magnitude.
pub(crate) fn check_numbers(
    place: impl Fn() -> String,
    what: &'static str,
    values: &[f64],
) -> Result<(), DescriptionError> {
    let invalid = values.iter().find(|value| !is_bounded(**value));
    let value = invalid.copied().unwrap_or(0.0);
    let expected = "finite numbers up to 1e6";
    require(invalid.is_none(), place, what, value, expected)
}
