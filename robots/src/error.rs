//! Errors of reading and controlling a robot.

use std::error::Error;
use std::fmt::{self, Arguments};
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
    /// A file that is too long.
    #[error("the URDF has more than {limit} bytes; give one robot, without meshes inside")]
    FileTooLong {
        /// Maximum number of bytes.
        limit: usize,
    },
    /// XML elements that are nested too deep.
    #[error("elements of the URDF are nested more than {limit} deep; URDF itself needs 5 levels")]
    XmlTooDeep {
        /// Maximum number of levels.
        limit: usize,
    },
    /// A file that is not XML, or not a URDF.
    #[error("the URDF cannot be parsed: {message}")]
    InvalidSyntax {
        /// Message of the parser.
        message: String,
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
    /// No links, or too many links or shapes.
    #[error("{place} has {count} {kind}s, expected {least} to {limit}")]
    CountOutOfRange {
        /// Robot, or one of its links.
        place: String,
        /// `link` or `collision shape`.
        kind: &'static str,
        /// Number in the file.
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
    /// A joint with more than one degree of freedom.
    #[error(
        "the joint `{joint}` is {kind}, which is not supported; use revolute, continuous, \
         prismatic or fixed"
    )]
    UnsupportedJointKind {
        /// Name of the joint.
        joint: String,
        /// Kind of the joint in URDF.
        kind: &'static str,
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
    /// Limits with a lower end that is not below the upper one.
    #[error(
        "the joint `{joint}` may move from {lower} to {upper}; give `<limit>` a lower limit below \
         the upper one, or make the joint continuous"
    )]
    InvalidLimits {
        /// Name of the joint.
        joint: String,
        /// Lower limit.
        lower: f64,
        /// Upper limit.
        upper: f64,
    },
    /// A moving link without mass.
    #[error("the joint `{joint}` moves the link `{link}`, which has no mass; give it `<inertial>`")]
    MissingInertia {
        /// Name of the link.
        link: String,
        /// Name of the joint.
        joint: String,
    },
    /// An inertia that no rigid body can have.
    #[error(
        "the link `{link}` has an inertia that no rigid body can have: {reason} (ixx {}, iyy {}, \
         izz {}, ixy {}, ixz {}, iyz {} kg m^2)",
        .tensor[0], .tensor[1], .tensor[2], .tensor[3], .tensor[4], .tensor[5]
    )]
    InvalidInertia {
        /// Name of the link.
        link: String,
        /// Components ixx, iyy, izz, ixy, ixz, iyz (kg m^2) along the axes of the inertial frame.
        tensor: [f64; 6],
        /// Violated condition.
        reason: &'static str,
    },
    /// A `<mimic>` of a joint that cannot be followed.
    #[error("the joint `{joint}` cannot follow `{followed}`: {reason}")]
    InvalidMimic {
        /// Name of the joint.
        joint: String,
        /// Name of the joint in `<mimic>`.
        followed: String,
        /// Reason for the rejection.
        reason: &'static str,
    },
    /// A joint that follows another one out of its own range.
    #[error(
        "the joint `{joint}` follows `{followed}`, which moves from {} to {}{}, to positions from \
         {} to {}, outside its own range, {} to {}: correct `<limit>` or `<mimic>` of `{joint}`{}",
        .ranges.followed[0], .ranges.followed[1], kept_by(.other), .ranges.required[0],
        .ranges.required[1], .ranges.own[0], .ranges.own[1], or_of(.other)
    )]
    FollowerRange {
        /// Name of the joint.
        joint: String,
        /// Name of the followed joint.
        followed: String,
        /// Ranges of both joints.
        ranges: Box<FollowerRanges>,
        /// Another follower of the same joint that has reduced its range, if any.
        other: Option<String>,
    },
    /// A collision mesh that cannot be used.
    #[error("the link `{link}` collides as the mesh `{file}`, which cannot be used: {reason}")]
    InvalidMesh {
        /// Name of the link.
        link: String,
        /// File of the mesh, as in the URDF.
        file: String,
        /// Reason for the rejection.
        reason: String,
    },
    /// A file outside of the URDF's folder.
    #[error("the link `{link}` names the file `{file}`, which lies outside of the URDF's folder")]
    MeshOutsideFolder {
        /// Name of the link.
        link: String,
        /// File, as in the URDF.
        file: String,
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
        miss: TipMiss,
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
        miss: TipMiss,
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

/// Ranges (radians, metres) of a joint that follows another one out of its own range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowerRanges {
    /// Range of the followed joint.
    pub followed: [f64; 2],
    /// Lowest and highest position to which the followed joint leads the follower.
    pub required: [f64; 2],
    /// Range of the follower.
    pub own: [f64; 2],
}

fn kept_by(other: &Option<String>) -> String {
    let of = other.as_ref();
    of.map_or_else(String::new, |joint| format!(" to keep `{joint}` in its range"))
}

fn or_of(other: &Option<String>) -> String {
    let of = other.as_ref();
    of.map_or_else(String::new, |joint| format!(" or of `{joint}`"))
}

/// Tip that is not at its target.
#[derive(Clone, Debug, PartialEq)]
pub struct TipMiss {
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

impl fmt::Display for TipMiss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { target, reached, distance, angle, joint } = self;
        write!(f, "{target}: it comes to {reached}, {distance} m and {angle} rad away")?;
        match joint {
            Some(joint) => write!(f, "; the joint `{joint}` is at the end of its range"),
            None => Ok(()),
        }
    }
}

/// Returns [`ControlError::NotFinite`] unless `holds`.
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

/// Returns [`DescriptionError::NumberOutOfRange`] unless `holds`.
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

/// Largest number in a robot's file, in any unit: larger ones are taken for mistakes.
pub(crate) const MAX_NUMBER: f64 = 1e6;

/// Rejects numbers that are not finite or exceed [`MAX_NUMBER`].
pub(crate) fn check_numbers(
    place: impl Fn() -> String,
    what: &'static str,
    values: &[f64],
) -> Result<(), DescriptionError> {
    // a comparison that is false for NaN, too
    let sound = |value: &f64| value.abs() <= MAX_NUMBER;
    let invalid = values.iter().find(|value| !sound(value));
    let value = invalid.copied().unwrap_or(0.0);
    let expected = "finite numbers up to 1e6";
    require(invalid.is_none(), place, what, value, expected)
}
