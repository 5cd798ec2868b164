//! Finds the camera: the arm carries a ball from pose to pose, and the camera looks.

use envs::carriers::Arm;
use inpainting::{Ball, Calibration, HandEye, InpaintingError, LEAST_POSES, Offset, Sighting};
use robots::{ControlError, Pose};
use serde::Serialize;

use crate::DeployError;

use super::approach::{Standing, approach, look};
use crate::rig::{Rig, Trial, then_stop};

/// What the arm carries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrateSettings {
    /// The ball.
    pub ball: Ball,
    /// Where it is in the frame of the hand.
    pub offset: Offset,
}

/// A pose that tells nothing.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// Its number, counted from 1.
    pub pose: usize,
    /// Why.
    pub why: String,
}

/// A camera that was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibrated {
    /// What the rig took the camera for.
    pub before: Calibration,
    /// The camera, and how sure that is.
    pub found: HandEye,
    /// Poses that were left out.
    pub left_out: Vec<LeftOut>,
}

/// Lets the arm carry its ball to `poses` over the table of `trial`, which should be empty, and
/// finds the camera from what it sees. The robot is told to stop at the end, and before an error is
/// returned.
///
/// Poses that the arm cannot reach, in which its hand does not come to rest, and in which the ball
/// is not seen are left out.
///
/// # Errors
/// [`DeployError::FewSightings`]; [`DeployError::Rig`], [`DeployError::Robot`],
/// [`DeployError::StalePicture`], [`DeployError::PictureOfTheFuture`]; as [`HandEye::solve`].
pub fn calibrate(
    rig: &mut dyn Rig,
    arm: &Arm,
    settings: &CalibrateSettings,
    poses: &[Pose],
    trial: &Trial,
) -> Result<Calibrated, DeployError> {
    let seen = carry(rig, arm, settings, poses, trial);
    let (sightings, left_out) = then_stop(rig, seen)?;
    if let (true, Some(first)) = (sightings.len() < LEAST_POSES, left_out.first()) {
        return Err(DeployError::FewSightings {
            got: sightings.len(),
            needed: LEAST_POSES,
            pose: first.pose,
            why: first.why.clone(),
        });
    }
    let before = rig.calibration();
    Ok(Calibrated {
        before,
        found: HandEye::solve(&before, settings.offset, &sightings)?,
        left_out,
    })
}

fn carry(
    rig: &mut dyn Rig,
    arm: &Arm,
    settings: &CalibrateSettings,
    poses: &[Pose],
    trial: &Trial,
) -> Result<(Vec<Sighting>, Vec<LeftOut>), DeployError> {
    let set_up = rig.set_up(trial);
    let set_up = set_up.map_err(|source| DeployError::Rig { source })?;
    let mut picture = set_up.background;
    let width = rig.calibration().intrinsics.width;
    let (mut sightings, mut left_out) = (Vec::new(), Vec::new());
    for (number, target) in poses.iter().enumerate() {
        let pose = number + 1;
        let found = visit(rig, arm, target, &mut picture)
            .and_then(|standing| Ok((standing.state, settings.ball.find(&picture, width)?)));
        match found {
            Ok((state, pixel)) => sightings.push(Sighting {
                pose,
                position: state.tip.position,
                rotation: state.tip.rotation,
                pixel,
            }),
            Err(error) if is_of_the_pose(&error) => {
                rig.stop()?;
                let why = error.to_string();
                left_out.push(LeftOut { pose, why });
            }
            Err(error) => return Err(error),
        }
    }
    Ok((sightings, left_out))
}

/// Goes to a pose and looks.
pub(super) fn visit(
    rig: &mut dyn Rig,
    arm: &Arm,
    target: &Pose,
    picture: &mut [u8],
) -> Result<Standing, DeployError> {
    approach(rig, arm, target)?;
    look(rig, picture)
}

/// Whether another pose may still do.
pub(super) fn is_of_the_pose(error: &DeployError) -> bool {
    use InpaintingError::{NoBall, NoDisc, SeveralBalls};
    matches!(
        error,
        DeployError::Robot(ControlError::OutOfReach { .. })
            | DeployError::Unreached { .. }
            | DeployError::Restless
            | DeployError::Inpainting(NoBall { .. } | NoDisc { .. } | SeveralBalls { .. })
    )
}
