//! Kinova Gen3 arm with seven joints and a Robotiq 2F-85 gripper.
//!
//! Sources of the figures: the descriptions and the user guide that Kinova publishes
//! (`ros2_kortex`), and closed forms of the gripper's linkage.

use std::f64::consts::{FRAC_PI_2, PI};

use crate::description::RobotDescription;
use crate::error::DescriptionError;

/// URDF of the Kinova Gen3 and its gripper.
///
/// Links: `end_effector_link` is the flange, `tool_link` Kinova's own tool frame for this gripper
/// (0.12 m from the flange), `pinch_link` the point between the pads (0.1443 m). Joints: `joint_1`
/// to `joint_7`, and the fingers `finger_l` and `finger_r`, open at 0 and closed at 0.0425 m; the
/// right one follows the left one.
pub const GEN3_URDF: &str = include_str!("../assets/urdf/kinova_gen3.urdf");

/// Joint positions (radians) of Kinova's pose "Home": the tool points away from the base, along x.
pub const HOME_JOINT_POSITIONS: [f64; 7] =
    [0.0, 15.0 / 180.0 * PI, PI, -130.0 / 180.0 * PI, 0.0, 55.0 / 180.0 * PI, FRAC_PI_2];
/// Joint positions (radians) of Kinova's pose "Retract": folded, the tool within four degrees of
/// straight down.
pub const RETRACT_JOINT_POSITIONS: [f64; 7] =
    [0.0, -20.0 / 180.0 * PI, PI, -146.0 / 180.0 * PI, 0.0, -50.0 / 180.0 * PI, FRAC_PI_2];
/// Joint positions (radians) of the Kinova Gen3 stretched upwards.
pub const ZERO_JOINT_POSITIONS: [f64; 7] = [0.0; 7];
/// Joint positions (radians) of the Kinova Gen3 for work on a table: the tool points straight down,
/// its frame 0.45 m in front of the base and 0.15 m above the base's plane. The fingers open
/// sideways.
pub const WORK_JOINT_POSITIONS: [f64; 7] = [0.0, 0.537, PI, -1.761, 0.0, -0.844, FRAC_PI_2];

/// Returns the Kinova Gen3 with its base at the world's origin: x points forwards, z up.
///
/// # Errors
/// Never in practice: the tests of the crate parse [`GEN3_URDF`].
pub fn gen3_description() -> Result<RobotDescription, DescriptionError> {
    RobotDescription::from_urdf(GEN3_URDF)
}
