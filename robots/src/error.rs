//! Errors of reading a robot and of moving it.

use std::error::Error;
use std::fmt::Arguments;
use std::path::PathBuf;

use glam::DVec3;

/// Why a file describes no robot, or a robot has no such part.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DescriptionError {
    /// The file cannot be read.
    #[error("cannot read `{}`: {source}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// The file is too long for a robot.
    #[error("the URDF has more than {limit} bytes; give one robot, without meshes inside")]
    TooLong {
        /// Bytes allowed.
        limit: usize,
    },
    /// Elements inside elements inside elements.
    #[error("elements of the URDF are nested more than {limit} deep; URDF itself needs 5 levels")]
    TooDeep {
        /// Levels allowed.
        limit: usize,
    },
    /// Not XML, or not a URDF.
    #[error("the URDF cannot be parsed: {message}")]
    Syntax {
        /// What the parser says.
        message: String,
    },
    /// A template that `xacro` has not expanded: everything that it would add is missing.
    #[error(
        "line {line}: {found} is xacro, not URDF: run `xacro FILE > arm.urdf` and read `arm.urdf`"
    )]
    Xacro {
        /// Line of the file (from one).
        line: usize,
        /// The element, or the attribute with its value.
        found: String,
    },
    /// No links, or more links or shapes than any robot has.
    #[error("{place} has {count} {kind}s, expected {least} to {limit}")]
    Count {
        /// The robot, or one of its links.
        place: String,
        /// `link` or `collision shape`.
        kind: &'static str,
        /// How many there are.
        count: usize,
        /// How many there must be.
        least: usize,
        /// How many there may be.
        limit: usize,
    },
    /// A name that cannot be used.
    #[error("the {kind} name {name:?} cannot be used: {reason}")]
    Name {
        /// `link`, `joint` or `robot`.
        kind: &'static str,
        /// The name.
        name: String,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// Two things of one name.
    #[error("two {kind}s are called `{name}`; names must be unique")]
    Duplicate {
        /// `link` or `joint`.
        kind: &'static str,
        /// The name.
        name: String,
    },
    /// A link that does not exist.
    #[error("there is no link `{link}`, which {asked} names; known: {}", .known.join(", "))]
    UnknownLink {
        /// The name asked for.
        link: String,
        /// Who asks, for instance a joint.
        asked: String,
        /// Every link.
        known: Vec<String>,
    },
    /// A link that two joints carry.
    #[error(
        "the link `{link}` is the child of the joints `{}` and `{}`; a link hangs on one joint",
        .joints[0], .joints[1]
    )]
    SeveralParents {
        /// The link.
        link: String,
        /// The joints.
        joints: [String; 2],
    },
    /// Links that hang on nothing.
    #[error("no joint carries the links {}; a robot has one root", .roots.join(", "))]
    SeveralRoots {
        /// The links.
        roots: Vec<String>,
    },
    /// Links that hang on themselves.
    #[error("the link `{link}` hangs on itself through its joints; links must form a tree")]
    Cycle {
        /// A link in the cycle, or one that hangs on the cycle.
        link: String,
    },
    /// A kind of joint that has more than one degree of freedom.
    #[error(
        "the joint `{joint}` is {kind}, which is not supported; use revolute, continuous, \
         prismatic or fixed"
    )]
    JointKind {
        /// The joint.
        joint: String,
        /// Its kind.
        kind: &'static str,
    },
    /// A number that makes no sense.
    #[error("{place}: {what} is {value}, expected {expected}")]
    Number {
        /// The link or joint.
        place: String,
        /// What the number is.
        what: &'static str,
        /// The number.
        value: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// Limits that leave no room.
    #[error(
        "the joint `{joint}` may move from {lower} to {upper}; give `<limit>` a lower limit below \
         the upper one, or make the joint continuous"
    )]
    Limits {
        /// The joint.
        joint: String,
        /// Lower limit.
        lower: f64,
        /// Upper limit.
        upper: f64,
    },
    /// A link that moves but has no mass.
    #[error("the joint `{joint}` moves the link `{link}`, which has no mass; give it `<inertial>`")]
    MissingInertia {
        /// The link.
        link: String,
        /// The joint.
        joint: String,
    },
    /// An inertia that no body has.
    #[error(
        "the link `{link}` has an inertia that no body has: {reason} (ixx {}, iyy {}, izz {}, \
         ixy {}, ixz {}, iyz {} kg m^2)",
        .tensor[0], .tensor[1], .tensor[2], .tensor[3], .tensor[4], .tensor[5]
    )]
    Inertia {
        /// The link.
        link: String,
        /// ixx, iyy, izz, ixy, ixz, iyz, with the axes of the link.
        tensor: [f64; 6],
        /// What is wrong with it.
        reason: &'static str,
    },
    /// A joint that follows what it cannot follow.
    #[error("the joint `{joint}` cannot follow `{followed}`: {reason}")]
    Mimic {
        /// The joint.
        joint: String,
        /// The joint that it names.
        followed: String,
        /// What is wrong.
        reason: &'static str,
    },
    /// A joint that follows another one out of its own range.
    #[error(
        "the joint `{joint}` follows `{followed}`, which moves from {} to {}{}, to positions from \
         {} to {}, outside its own range, {} to {}: correct `<limit>` or `<mimic>` of `{joint}`{}",
        .ranges.followed[0], .ranges.followed[1], kept_by(.other), .ranges.led[0], .ranges.led[1],
        .ranges.own[0], .ranges.own[1], or_of(.other)
    )]
    FollowerRange {
        /// The joint.
        joint: String,
        /// The joint that it follows.
        followed: String,
        /// Ranges of both.
        ranges: Box<FollowerRanges>,
        /// Another joint that follows the same one and has made its range smaller, if any.
        other: Option<String>,
    },
    /// A collision shape from a file that cannot be used.
    #[error("the link `{link}` collides as the mesh `{file}`, which cannot be used: {reason}")]
    Mesh {
        /// The link.
        link: String,
        /// The mesh's file as the URDF names it.
        file: String,
        /// What is wrong.
        reason: String,
    },
    /// A file outside of the URDF's folder.
    #[error("the link `{link}` names the file `{file}`, which lies outside of the URDF's folder")]
    FileOutside {
        /// The link.
        link: String,
        /// The file as the URDF names it.
        file: String,
    },
    /// More links in a row than MuJoCo reads.
    #[error(
        "the link `{link}` hangs on {limit} others in a row, and MuJoCo 2.2.2 reads at most {limit} \
         links in a row: make one link of links that are fixed to each other"
    )]
    LongRow {
        /// The first link that is too far from the root.
        link: String,
        /// Links allowed, the root among them.
        limit: usize,
    },
    /// A chain that cannot be moved by itself.
    #[error("the way to the link `{tip}` cannot be controlled: {reason}")]
    Chain {
        /// The link at its end.
        tip: String,
        /// What is wrong.
        reason: String,
    },
}

/// Why an arm does not do what it is told. It stands still then, but for
/// [`ControlError::NotStopped`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ControlError {
    /// A command that holds a number that is not finite.
    #[error("{what} is {value}, expected finite numbers; the arm is stopped")]
    NotFinite {
        /// What the number is part of.
        what: &'static str,
        /// It.
        value: String,
    },
    /// A setting out of range.
    #[error("{name} is {value}, expected {expected}")]
    Setting {
        /// The setting.
        name: &'static str,
        /// Its value.
        value: String,
        /// What was expected.
        expected: &'static str,
    },
    /// A posture with a joint outside of its range.
    #[error(
        "the joint `{joint}` is at {position}, outside of its range {} to {}",
        .range[0], .range[1]
    )]
    Posture {
        /// The joint.
        joint: String,
        /// Its position (metres or radians).
        position: f64,
        /// Its range.
        range: [f64; 2],
    },
    /// A place that the arm cannot get to.
    #[error(
        "the arm cannot reach {target} in this orientation: it comes to {reached}, {distance} m \
         and {angle} rad away{}", at_limit(.joint)
    )]
    OutOfReach {
        /// Where the tip should be (metres, world).
        target: DVec3,
        /// Where it gets to (metres, world).
        reached: DVec3,
        /// How far apart they are (metres).
        distance: f64,
        /// How far the tip is turned from where it should be (radians).
        angle: f64,
        /// A joint at the end of its range, if that is what stops the arm.
        joint: Option<String>,
    },
    /// The robot, or the way to it, failed.
    #[error("the robot failed: {source}")]
    Driver {
        /// Its own reason.
        source: Box<dyn Error + Send + Sync>,
    },
    /// The arm should have been stopped and could not be.
    #[error("{cause}; AND THE ARM COULD NOT BE STOPPED: {source}")]
    NotStopped {
        /// Why it should have been stopped.
        cause: String,
        /// Why it was not.
        source: Box<ControlError>,
    },
}

/// Ranges (radians, metres) of a joint that follows another one out of its own range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowerRanges {
    /// Range of the followed joint.
    pub followed: [f64; 2],
    /// Positions to which the followed joint leads the follower.
    pub led: [f64; 2],
    /// Range of the follower.
    pub own: [f64; 2],
}

fn kept_by(other: &Option<String>) -> String {
    let of = other.as_ref();
    of.map_or_else(String::new, |other| format!(" to keep `{other}` in its range"))
}

fn or_of(other: &Option<String>) -> String {
    let of = other.as_ref();
    of.map_or_else(String::new, |other| format!(" or of `{other}`"))
}

fn at_limit(joint: &Option<String>) -> String {
    match joint {
        Some(joint) => format!("; the joint `{joint}` is at the end of its range"),
        None => String::new(),
    }
}

/// Refuses what holds numbers that are not finite.
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
    Err(DescriptionError::Number { place: place(), what, value, expected })
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
