#![doc = include_str!("../README.md")]

mod capsule;
mod chain;
mod control;
mod description;
mod error;
mod fit;
pub mod gen3;
mod gravity;
mod ik;
mod inertia;
mod kinematic_arm;
mod mjcf;
mod overlap;
mod pose;
mod robot;
mod twist;
mod urdf;
mod watchdog;

pub use capsule::{Capsule, PlacedShape, Shape};
pub use chain::{Chain, ChainJoint};
pub use control::{CartesianControl, ControlSettings};
pub use description::{Description, Drive, Inertia, Joint, Link, Motion, MotionKind, Restriction};
pub use error::{ControlError, DescriptionError};
pub use kinematic_arm::KinematicArm;
pub use mjcf::{Addition, Mjcf, MjcfSettings, Servo};
pub use pose::Pose;
pub use robot::{Command, Robot, RobotState};
pub use twist::{Twist, TwistLimits};
pub use urdf::{MAX_BYTES, MAX_LINKS, UrdfSettings};
pub use watchdog::Watchdog;
