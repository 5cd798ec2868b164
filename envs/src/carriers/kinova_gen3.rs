//! A Kinova Gen3 with a Robotiq gripper, driven as a real one is.

use std::f64::consts::FRAC_PI_2;
use std::sync::OnceLock;

use glam::DVec3;
use robots::{ControlSettings, Pose, Servo, TwistLimits, gen3};

use super::arm::{Arm, ArmSettings, Finger, Gripper};
use crate::carrier::{Carrier, CarrierParts};
use crate::drive::{Drive, Posture};
use crate::error::EnvError;

/// A Kinova Gen3 with a Robotiq 2F-85 gripper, on a pedestal behind the table's centre. Its hand is
/// `tool_link`, which points down, and its fingers open along y, as the Sawyer arm's do.
#[derive(Clone, Copy, Debug)]
pub struct KinovaGen3;

/// Where it stands (metres): all places of the tasks are within its reach.
const BASE: [f64; 3] = [0.0, -0.44, 0.15];
/// The joint that closes the fingers.
const FINGER: &str = "finger_l";
/// Where the finger joint is open for tasks (metres): as far outside as the Sawyer arm's open claws
/// (53 mm from the middle), so that a finger comes down before what it is to push, not upon it.
const OPEN: f64 = 0.023;
/// Where it is closed.
const CLOSED: f64 = 0.0425;
/// From a finger's link, the inner face of its pad, outwards to what tasks look at (metres): open
/// claws are 0.1 m apart.
const CLAW: f64 = 0.0305;
/// From the middle of a pad to its lower end (metres).
const TIP: f64 = 0.01875;
/// How far the target is ahead of the hand at most (metres).
const LEAD: f64 = 0.034;
/// Acceleration of the hand (m/s^2): what the arm's hard limit, 4.94 rad/s^2 of its first four
/// joints, leaves at 0.4 m from an axis. Its driver's default of 0.4 m/s^2 takes 13 cm to stop from
/// the speed of a full action, so that hands pass what they are sent to.
const ACCELERATION: f64 = 2.0;

impl KinovaGen3 {
    /// The arm with which the embodiment is made.
    ///
    /// # Errors
    /// None: the crate's tests make it.
    pub fn arm(&self) -> Result<Arm, EnvError> {
        let finger = |link: &str, outwards: f64| Finger {
            link: link.to_owned(),
            claw: DVec3::new(outwards * CLAW, 0.0, 0.0),
            tip: DVec3::new(0.0, 0.0, TIP),
        };
        let [pan, shoulder, turn, elbow, forearm, wrist, roll] = gen3::WORK;
        Arm::new(ArmSettings {
            name: self.name().to_owned(),
            robot: gen3::description()?
                .placed(Pose::from_xyz_rpy(BASE, [0.0, 0.0, FRAC_PI_2]))?
                .narrowed(FINGER, [OPEN, CLOSED])?,
            hand: "tool_link".to_owned(),
            ready: vec![pan, shoulder, turn, elbow, forearm, wrist, roll - FRAC_PI_2],
            gripper: Gripper {
                link: "gripper_link".to_owned(),
                fingers: [finger("finger_r_link", -1.0), finger("finger_l_link", 1.0)],
                joint: Some(FINGER.to_owned()),
            },
            control: ControlSettings {
                limits: TwistLimits { acceleration: ACCELERATION, ..TwistLimits::default() },
                ..ControlSettings::default()
            },
            servo: Servo::default(),
            lead: LEAD,
            additions: Vec::new(),
        })
    }
}

/// The arm, made once.
fn made() -> Result<&'static Arm, EnvError> {
    static ARM: OnceLock<Arm> = OnceLock::new();
    if let Some(arm) = ARM.get() {
        return Ok(arm);
    }
    let arm = KinovaGen3.arm()?;
    Ok(ARM.get_or_init(|| arm))
}

impl Carrier for KinovaGen3 {
    fn name(&self) -> &str {
        "kinova_gen3"
    }

    fn parts(&self) -> Result<CarrierParts, EnvError> {
        made()?.parts()
    }

    fn posture(&self, hand_target: DVec3) -> Result<Posture, EnvError> {
        made()?.posture(hand_target)
    }

    fn drive(&self) -> Result<Drive, EnvError> {
        made()?.drive()
    }
}
