#![doc = include_str!("../README.md")]

mod capsule;
mod chain;
mod changes;
mod check;
mod control;
mod description;
mod error;
mod fit;
pub mod gen3;
mod gravity;
mod hand;
mod hull;
mod ik;
mod inertia;
mod kinematic_arm;
mod mjcf;
mod overlap;
mod pose;
mod robot;
mod robot_file;
mod twist;
mod urdf;
mod watchdog;

pub use capsule::{Capsule, PlacedShape, Shape};
pub use chain::{Chain, ChainJoint};
pub use check::{JointSummary, RobotCheckReport};
pub use control::{TwistControlSettings, TwistController};
pub use description::{
    Inertia, Joint, JointMotionKind, JointMotionSpec, JointPositionSource, JointRangeRestriction,
    Link, MAX_LINKS, RobotDescription,
};
pub use error::{ControlError, DescriptionError, MissedTarget};
pub use ik::{IkSettings, OrientationConstraint};
pub use kinematic_arm::KinematicArm;
pub use mjcf::{
    JointServoSettings, LinkMjcfAddition, Mjcf, MjcfSettings, TouchingLinkPairs, xml_escaped,
};
pub use pose::Pose;
pub use robot::{ArmCommand, Robot, RobotState};
pub use robot_file::{RobotFile, without_byte_order_mark};
pub use twist::{Twist, TwistLimits};
pub use urdf::{MAX_URDF_BYTES, UrdfSettings};
pub use watchdog::Watchdog;
