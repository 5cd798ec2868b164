//! Measurement of a calibration: the arm carries a ball from pose to pose in view of the camera.

use envs::embodiments::Arm;
use inpainting::{
    Ball, BallSighting, Calibration, Distortion, HandEye, HandEyeSettings, InpaintingError,
    Intrinsics, MIN_POSES, Residual,
};
use robots::{ControlError, Pose};
use serde::Serialize;

use crate::DeployError;

use super::approach::{RestingHand, approach, capture_at_rest};
use crate::rig::{Rig, Trial, then_stop};

/// Settings of a calibration: the ball that the arm carries, and what is known of arm and camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrateSettings {
    /// Ball that the arm carries.
    pub ball: Ball,
    /// Settings of the fit: the ball's position in the hand, if it is known, the arm's accuracy,
    /// and `true` to estimate the focal lengths.
    pub hand_eye: HandEyeSettings,
    /// Intrinsics and lens of the camera; `None` to use those of the rig's own calibration.
    pub camera: Option<(Intrinsics, Distortion)>,
}

/// Pose of the hand that was skipped, with the reason.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SkippedPose {
    /// Number of the pose, counted from 1.
    pub pose: usize,
    /// Reason for which the pose was skipped.
    pub why: String,
}

/// Result of a camera calibration with the ball.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibrated {
    /// Calibration that the rig had before.
    pub before: Calibration,
    /// Calibration that was found, with its uncertainty.
    pub found: HandEye,
    /// Poses of the calibration that were skipped, and those that the others contradict.
    pub left_out: Vec<SkippedPose>,
}

/// Calibrates the camera: the arm carries its ball to `poses` over the table of `trial`, which
/// should be empty. The robot is stopped at the end and before any error is returned.
///
/// Poses that the arm cannot reach, in which its hand does not come to rest, or in which the ball
/// is not seen are skipped. So are poses that the others contradict, as long as ten remain.
///
/// # Errors
/// [`DeployError::FewSightings`]; [`DeployError::Rig`], [`DeployError::Robot`],
/// [`DeployError::StalePicture`], [`DeployError::CameraClockAhead`]; as [`HandEye::solve`].
pub fn calibrate(
    rig: &mut dyn Rig,
    arm: &Arm,
    settings: &CalibrateSettings,
    poses: &[Pose],
    trial: &Trial,
) -> Result<Calibrated, DeployError> {
    settings.hand_eye.check()?;
    let seen = carry(rig, arm, settings, poses, trial);
    let (sightings, mut left_out) = then_stop(rig, seen)?;
    // without a skipped pose, too few poses were given, which `HandEye::solve` reports
    if let Some(first) = left_out.first()
        && sightings.len() < MIN_POSES
    {
        return Err(DeployError::FewSightings {
            got: sightings.len(),
            needed: MIN_POSES,
            pose: first.pose,
            why: first.why.clone(),
        });
    }
    let before = rig.calibration();
    let start = settings.camera.map_or(before, |(intrinsics, distortion)| Calibration {
        intrinsics,
        distortion,
        ..before
    });
    let found = HandEye::solve(&start, settings.hand_eye, &sightings)?;
    left_out.extend(found.left_out.iter().map(|&Residual { pose, pixels, .. }| SkippedPose {
        pose,
        why: if pixels.is_finite() {
            format!("the ball is seen {pixels:.1} pixels from where the other poses predict it")
        } else {
            "the other poses predict the ball out of the camera's sight".to_owned()
        },
    }));
    Ok(Calibrated { before, found, left_out })
}

/// Visits all poses; returns the places of the ball and the poses that were skipped.
fn carry(
    rig: &mut dyn Rig,
    arm: &Arm,
    settings: &CalibrateSettings,
    poses: &[Pose],
    trial: &Trial,
) -> Result<(Vec<BallSighting>, Vec<SkippedPose>), DeployError> {
    let set_up = rig.set_up(trial).map_err(|source| DeployError::Rig { source })?;
    // the empty table is not needed: its memory takes the pictures
    let mut picture = set_up.background;
    let width = rig.calibration().intrinsics.width;
    let (mut sightings, mut left_out) = (Vec::new(), Vec::new());
    for (number, target) in poses.iter().enumerate() {
        let pose = number + 1;
        let found = visit(rig, arm, target, &mut picture)
            .and_then(|standing| Ok((standing.state, settings.ball.find(&picture, width)?)));
        match found {
            Ok((state, pixel)) => sightings.push(BallSighting {
                pose,
                position: state.tip.position,
                rotation: state.tip.rotation,
                pixel,
            }),
            Err(error) if concerns_one_pose(&error) => {
                // the arm may still be on its way
                rig.stop()?;
                let why = error.to_string();
                left_out.push(SkippedPose { pose, why });
            }
            Err(error) => return Err(error),
        }
    }
    Ok((sightings, left_out))
}

/// Moves the hand to a pose and takes a picture of it at rest.
pub(super) fn visit(
    rig: &mut dyn Rig,
    arm: &Arm,
    target: &Pose,
    picture: &mut [u8],
) -> Result<RestingHand, DeployError> {
    approach(rig, arm, target)?;
    capture_at_rest(rig, picture)
}

/// Returns `true` if an error concerns one pose alone, so that another pose may work.
pub(super) fn concerns_one_pose(error: &DeployError) -> bool {
    use InpaintingError::{NoBall, NoDisc, SeveralBalls};
    matches!(
        error,
        DeployError::Robot(ControlError::CannotFollow { .. })
            | DeployError::PoseNotReached { .. }
            | DeployError::HandNotAtRest
            | DeployError::Inpainting(NoBall { .. } | NoDisc { .. } | SeveralBalls { .. })
    )
}
