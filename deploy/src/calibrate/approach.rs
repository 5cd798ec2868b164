//! Motion of the arm's hand to a pose, and a camera picture of the hand at rest.

use std::time::Duration;

use envs::embodiments::Arm;
use robots::{ArmCommand, Pose, RobotState};

use crate::DeployError;

use crate::controller::COMMAND_PERIOD;
use crate::rig::{Rig, newest_picture};

/// Proportional gain (1/s) from the remaining distance of the hand to its speed. Low enough to be
/// stable with the delay of commands.
const RATE: f64 = 4.0;
/// Distance (metres) and angle (radians) from its target at which the hand counts as arrived. More
/// precision is not needed, because the calibration uses the measured pose.
const NEAR: [f64; 2] = [0.003, 0.02];
/// Maximum time in which the hand must reach one pose.
const LONGEST: Duration = Duration::from_secs(20);
/// Maximum motion (metres, radians) of a hand at rest during [`PAUSE`].
const STILL: [f64; 2] = [1e-4, 5e-4];
/// Time over which the motion of the hand is measured to tell if it rests.
const PAUSE: Duration = Duration::from_millis(100);
/// Maximum time until the hand is at rest, and then until a picture of it arrives.
const PATIENCE: Duration = Duration::from_secs(2);

/// Moves the hand in a straight line to within 3 mm and 0.02 radians of `target`, and stops the
/// robot there.
///
/// # Errors
/// [`DeployError::Robot`], [`DeployError::Rig`], [`DeployError::PoseNotReached`]; the arm may be
/// moving.
pub fn move_hand_to(rig: &mut dyn Rig, arm: &Arm, target: &Pose) -> Result<(), DeployError> {
    let limits = arm.settings().control.limits;
    let until = rig.now() + LONGEST;
    loop {
        let state = rig.state()?;
        let way = state.tip.displacement_to(target);
        let [place, turn] = way.map(|way| way.length());
        if place < NEAR[0] && turn < NEAR[1] {
            return Ok(rig.stop()?);
        }
        if rig.now() > until {
            return Err(DeployError::PoseNotReached {
                remaining_mm: 1e3 * place,
                remaining_deg: turn.to_degrees(),
            });
        }
        // the fingers keep their opening
        rig.command(&ArmCommand {
            twist: limits.twist_towards(way, RATE),
            gripper_closure: state.gripper_closure,
        })?;
        wait(rig, COMMAND_PERIOD)?;
    }
}

/// State of the arm while its hand rests, and the time since which it rests.
#[derive(Clone, Debug)]
pub struct ArmStateAtRest {
    /// Time on the rig's clock since which the hand rests.
    pub since: Duration,
    /// State of the arm at rest.
    pub state: RobotState,
}

/// Waits until the hand rests, copies a camera picture of it at rest into `rgb`, and returns the
/// arm's state.
///
/// # Errors
/// [`DeployError::Robot`], [`DeployError::Rig`]; [`DeployError::HandNotAtRest`] for a hand that
/// keeps moving, [`DeployError::StalePicture`] if no picture of the hand at rest arrives, and
/// [`DeployError::CameraClockAhead`] for a camera whose clock is ahead.
pub fn capture_at_rest(rig: &mut dyn Rig, rgb: &mut [u8]) -> Result<ArmStateAtRest, DeployError> {
    rest(rig)?;
    let since = rig.now();
    loop {
        let taken = newest_picture(rig, rgb)?;
        // an earlier picture may show the hand in motion
        if taken >= since {
            let state = rig.state()?;
            return Ok(ArmStateAtRest { since, state });
        }
        if rig.now() > since + PATIENCE {
            let (age, max_age) = (rig.now() - taken, PATIENCE);
            return Err(DeployError::StalePicture { age, max_age });
        }
        wait(rig, COMMAND_PERIOD)?;
    }
}

/// Waits until the hand neither moves nor turns.
///
/// # Errors
/// [`DeployError::HandNotAtRest`] after [`PATIENCE`]; errors of the rig.
fn rest(rig: &mut dyn Rig) -> Result<(), DeployError> {
    let until = rig.now() + PATIENCE;
    let mut before = rig.state()?.tip;
    loop {
        wait(rig, PAUSE)?;
        let tip = rig.state()?.tip;
        let [moved, turned] = before.displacement_to(&tip).map(|way| way.length());
        if moved < STILL[0] && turned < STILL[1] {
            return Ok(());
        }
        if rig.now() > until {
            return Err(DeployError::HandNotAtRest);
        }
        // from pause to pause, since the hand may still be braking in the first ones
        before = tip;
    }
}

fn wait(rig: &mut dyn Rig, time: Duration) -> Result<(), DeployError> {
    rig.wait(time).map_err(|source| DeployError::Rig { source })
}
