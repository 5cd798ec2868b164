//! Kinova Gen3 with a Robotiq gripper, controlled like a real one.

use std::borrow::Cow;
use std::f64::consts::FRAC_PI_2;

use glam::DVec3;
use robots::{JointServoSettings, Pose, TwistControlSettings, TwistLimits, gen3};

use super::arm::{Arm, ArmSettings, Finger, FingerJoint, Gripper};
use super::lazy_arm::LazyArm;
use crate::error::EnvError;

/// Kinova Gen3 with a Robotiq 2F-85 gripper, on a pedestal 0.44 m behind the table's centre. Its
/// hand is `tool_link`, which points down, and its fingers open along y, like the Sawyer arm's.
#[derive(Clone, Copy, Debug)]
pub struct KinovaGen3;

/// Embodiment with this arm.
pub(crate) static KINOVA_GEN3: LazyArm = LazyArm::new(Cow::Borrowed(NAME), |_| KinovaGen3.arm());

/// Name of the embodiment.
const NAME: &str = "kinova_gen3";
/// Position of the base (metres). All placements of the tasks are within reach from there.
const BASE: [f64; 3] = [0.0, -0.44, 0.15];
/// Name of the joint that closes the fingers.
const FINGER: &str = "finger_l";
/// Finger joint's open position for tasks (metres). The fingers then reach as far out as the Sawyer
/// arm's open claws (53 mm from the middle), so that a finger comes down in front of an object to
/// push, not on top of it.
const OPEN: f64 = 0.023;
/// Finger joint's closed position (metres).
const CLOSED: f64 = 0.0425;
/// Distance (metres) from the inner face of a finger's pad outwards to the point that tasks treat
/// as the claw. Open claws are then 0.1 m apart.
const CLAW: f64 = 0.0305;
/// Distance from the middle of a pad to its lower end (metres).
const TIP: f64 = 0.01875;
/// Largest distance of the hand's target from the hand (metres), tuned for decisions at 8 Hz: with
/// 28 to 33 mm some pucks stay short of their goal, with 35 mm one button of 300 was not pressed.
pub(super) const LEAD: f64 = 0.034;
/// Maximum acceleration of the hand (m/s^2): that which the arm's hard limit of 4.94 rad/s^2 for
/// its first four joints allows at 0.4 m from an axis. With the driver's default of 0.4 m/s^2 the
/// hand needs 13 cm to stop from the speed of a full action (0.32 m/s), and overshoots its targets.
pub(super) const ACCELERATION: f64 = 2.0;

impl KinovaGen3 {
    /// Builds the arm: the Kinova Gen3 with its gripper and control.
    ///
    /// # Errors
    /// None in practice: the crate's tests build it.
    pub fn arm(&self) -> Result<Arm, EnvError> {
        let finger = |link: &str, outwards: f64| Finger {
            link: link.to_owned(),
            claw_point: DVec3::new(outwards * CLAW, 0.0, 0.0),
            tip_point: DVec3::new(0.0, 0.0, TIP),
        };
        let [pan, shoulder, turn, elbow, forearm, wrist, roll] = gen3::WORK_JOINT_POSITIONS;
        Arm::new(ArmSettings {
            name: NAME.to_owned(),
            robot: gen3::gen3_description()?
                .with_base_pose(Pose::from_xyz_rpy(BASE, [0.0, 0.0, FRAC_PI_2]))?
                .with_joint_range(FINGER, [OPEN, CLOSED])?,
            hand_link: "tool_link".to_owned(),
            // a quarter turn, so that the fingers open along y
            ready_joint_positions: vec![
                pan,
                shoulder,
                turn,
                elbow,
                forearm,
                wrist,
                roll - FRAC_PI_2,
            ],
            gripper: Gripper {
                link: "gripper_link".to_owned(),
                fingers: [finger("finger_r_link", -1.0), finger("finger_l_link", 1.0)],
                joint: Some(FingerJoint { name: FINGER.to_owned(), positions: [OPEN, CLOSED] }),
            },
            control: TwistControlSettings {
                limits: TwistLimits { max_acceleration: ACCELERATION, ..TwistLimits::default() },
                ..TwistControlSettings::default()
            },
            servo: JointServoSettings::default(),
            max_target_lead: LEAD,
            additions: Vec::new(),
        })
    }
}
