//! Brings the hand to a pose, and looks at it once it stands.

use std::time::Duration;

use envs::carriers::Arm;
use robots::{Command, Pose, RobotState};

use crate::DeployError;

use crate::pilot::TICK;
use crate::rig::{Rig, newest_picture};

/// Rate (1/s) at which what is left of the way is covered: slow enough for an arm that obeys late.
const RATE: f64 = 4.0;
/// How near (metres, radians) the hand comes. Where it is exactly, the joints say.
const NEAR: [f64; 2] = [0.003, 0.02];
/// Longest time for one way.
const LONGEST: Duration = Duration::from_secs(20);
/// The hand stands if it moves and turns less than this (metres, radians) ...
const STILL: [f64; 2] = [1e-4, 5e-4];
/// ... within this time.
const PAUSE: Duration = Duration::from_millis(100);
/// How long a hand may take to stand, and a picture to come.
const PATIENCE: Duration = Duration::from_secs(2);

/// Moves the hand to `target` in a straight line, and tells the robot to stop there.
///
/// # Errors
/// [`DeployError::Robot`], [`DeployError::Rig`], [`DeployError::Unreached`]; the arm may be moving.
pub fn approach(rig: &mut dyn Rig, arm: &Arm, target: &Pose) -> Result<(), DeployError> {
    let limits = arm.settings().control.limits;
    let until = rig.now() + LONGEST;
    loop {
        let state = rig.state()?;
        let way = state.tip.way_to(target);
        let [place, turn] = way.map(|way| way.length());
        if place < NEAR[0] && turn < NEAR[1] {
            return Ok(rig.stop()?);
        }
        if rig.now() > until {
            return Err(DeployError::Unreached { left: 1e3 * place, turn: turn.to_degrees() });
        }
        rig.command(&Command { twist: limits.towards(way, RATE), closing: state.closing })?;
        wait(rig, TICK)?;
    }
}

/// A hand that stands.
#[derive(Clone, Debug)]
pub struct Standing {
    /// From when on it does.
    pub since: Duration,
    /// Where.
    pub state: RobotState,
}

/// Waits until the hand stands, copies a picture into `rgb` that shows it so, and says where it is.
///
/// # Errors
/// [`DeployError::Robot`], [`DeployError::Rig`]; [`DeployError::Restless`] for a hand that does not
/// come to rest, [`DeployError::StalePicture`] for a camera that does not show it, and
/// [`DeployError::PictureOfTheFuture`] for one whose clock is ahead.
pub fn look(rig: &mut dyn Rig, rgb: &mut [u8]) -> Result<Standing, DeployError> {
    rest(rig)?;
    let since = rig.now();
    loop {
        let taken = newest_picture(rig, rgb)?;
        if taken >= since {
            let state = rig.state()?;
            return Ok(Standing { since, state });
        }
        if rig.now() > since + PATIENCE {
            let (age, most) = (rig.now() - taken, PATIENCE);
            return Err(DeployError::StalePicture { age, most });
        }
        wait(rig, TICK)?;
    }
}

/// Waits until the hand neither moves nor turns.
fn rest(rig: &mut dyn Rig) -> Result<(), DeployError> {
    let until = rig.now() + PATIENCE;
    let mut before = rig.state()?.tip;
    loop {
        wait(rig, PAUSE)?;
        let tip = rig.state()?.tip;
        let [moved, turned] = before.way_to(&tip).map(|way| way.length());
        if moved < STILL[0] && turned < STILL[1] {
            return Ok(());
        }
        if rig.now() > until {
            return Err(DeployError::Restless);
        }
        before = tip;
    }
}

fn wait(rig: &mut dyn Rig, time: Duration) -> Result<(), DeployError> {
    rig.wait(time).map_err(|source| DeployError::Rig { source })
}
