//! Measurement for a camera calibration: the arm carries a ball from pose to pose under the camera.

use envs::embodiments::Arm;
use inpainting::{
    BallResidual, BallSighting, CalibrationBall, CameraCalibration, HandEyeCalibration,
    HandEyeSettings, InpaintingError, Intrinsics, LensDistortion, MIN_CALIBRATION_POSES,
};
use robots::{ControlError, Pose};
use serde::Serialize;

use crate::DeployError;

use super::approach::{ArmStateAtRest, capture_at_rest, move_hand_to};
use crate::rig::{Rig, Trial, stop_after};

/// Settings of a camera calibration: the arm's ball, and what is known of arm and camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraCalibrationSettings {
    /// Ball that the arm carries.
    pub ball: CalibrationBall,
    /// Settings of the least-squares fit: the ball's position in the hand, if it is known, the
    /// arm's accuracy, and `true` to estimate the focal lengths.
    pub hand_eye: HandEyeSettings,
    /// Intrinsics and distortion of the camera; `None` to use those of the rig's own calibration.
    pub lens: Option<(Intrinsics, LensDistortion)>,
}

/// Number of a pose of the hand that was skipped, and the reason.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SkippedPose {
    /// Number of the pose of the hand, counted from 1.
    #[serde(rename = "pose")]
    pub pose_number: usize,
    /// Reason for which the pose was skipped.
    #[serde(rename = "why")]
    pub reason: String,
}

/// Result of a camera calibration with the ball.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraCalibrationResult {
    /// Calibration of the camera that the rig had before.
    pub previous: CameraCalibration,
    /// Calibration of the camera that was found, with its uncertainty.
    pub estimate: HandEyeCalibration,
    /// Poses of the calibration that were skipped, and those that the others contradict.
    pub skipped_poses: Vec<SkippedPose>,
}

/// Calibrates the camera: the arm carries its ball to `poses` over the table of `trial`, which
/// should be empty. The robot is stopped at the end and before any error is returned.
///
/// Poses that the arm cannot reach, in which its hand does not come to rest, or in which the ball
/// is not seen are skipped. So are poses that the others contradict, as long as ten remain.
///
/// # Errors
/// [`DeployError::TooFewSightings`]; [`DeployError::Rig`], [`DeployError::Robot`],
/// [`DeployError::StalePicture`], [`DeployError::CameraClockAhead`]; as
/// [`HandEyeCalibration::solve`].
pub fn calibrate_camera(
    rig: &mut dyn Rig,
    arm: &Arm,
    settings: &CameraCalibrationSettings,
    poses: &[Pose],
    trial: &Trial,
) -> Result<CameraCalibrationResult, DeployError> {
    settings.hand_eye.check()?;
    settings.ball.check()?;
    let seen = carry(rig, arm, settings, poses, trial);
    let (sightings, mut skipped_poses) = stop_after(rig, seen)?;
    // without a skipped pose, too few poses were given, which `HandEyeCalibration::solve` reports
    if let Some(first) = skipped_poses.first()
        && sightings.len() < MIN_CALIBRATION_POSES
    {
        return Err(DeployError::TooFewSightings {
            sightings: sightings.len(),
            needed: MIN_CALIBRATION_POSES,
            skipped_pose: first.pose_number,
            reason: first.reason.clone(),
        });
    }
    let previous = rig.calibration();
    let start = settings.lens.map_or(previous, |(intrinsics, distortion)| CameraCalibration {
        intrinsics,
        distortion,
        ..previous
    });
    let estimate = HandEyeCalibration::solve(&start, settings.hand_eye, &sightings)?;
    skipped_poses.extend(estimate.outliers.iter().map(
        |&BallResidual { pose_number: pose, distance_px: pixels, .. }| SkippedPose {
            pose_number: pose,
            reason: if pixels.is_finite() {
                format!("the ball is seen {pixels:.1} pixels from where the other poses predict it")
            } else {
                "the other poses predict the ball out of the camera's sight".to_owned()
            },
        },
    ));
    Ok(CameraCalibrationResult { previous, estimate, skipped_poses })
}

/// Carries the ball to all poses; returns its positions in the pictures, and the skipped poses.
fn carry(
    rig: &mut dyn Rig,
    arm: &Arm,
    settings: &CameraCalibrationSettings,
    poses: &[Pose],
    trial: &Trial,
) -> Result<(Vec<BallSighting>, Vec<SkippedPose>), DeployError> {
    let set_up = rig.set_up(trial).map_err(|source| DeployError::Rig { source })?;
    // the empty table is not needed: its memory takes the pictures
    let mut picture = set_up.background;
    let width = rig.calibration().intrinsics.width;
    let (mut sightings, mut skipped_poses) = (Vec::new(), Vec::new());
    for (number, target) in poses.iter().enumerate() {
        let pose = number + 1;
        let found = capture_in_pose(rig, arm, target, &mut picture)
            .and_then(|standing| Ok((standing.state, settings.ball.find_centre(&picture, width)?)));
        match found {
            Ok((state, pixel)) => sightings.push(BallSighting {
                pose_number: pose,
                hand_position: state.tip.position,
                hand_rotation: state.tip.rotation,
                ball_pixel: pixel,
            }),
            Err(error) if concerns_one_pose(&error) => {
                // the arm may still be on its way
                rig.stop()?;
                let reason = error.to_string();
                skipped_poses.push(SkippedPose { pose_number: pose, reason });
            }
            Err(error) => return Err(error),
        }
    }
    Ok((sightings, skipped_poses))
}

/// Moves the hand to a pose and takes a picture of it at rest.
pub(super) fn capture_in_pose(
    rig: &mut dyn Rig,
    arm: &Arm,
    target: &Pose,
    picture: &mut [u8],
) -> Result<ArmStateAtRest, DeployError> {
    move_hand_to(rig, arm, target)?;
    capture_at_rest(rig, picture)
}

/// Returns `true` if an error concerns one pose of the hand alone, so that another pose may work.
pub(super) fn concerns_one_pose(error: &DeployError) -> bool {
    use InpaintingError::{BallPartlyHidden, NoBall, SeveralBalls};
    matches!(
        error,
        DeployError::Robot(ControlError::CannotFollow { .. })
            | DeployError::PoseNotReached { .. }
            | DeployError::HandNotAtRest
            | DeployError::Inpainting(
                NoBall { .. } | BallPartlyHidden { .. } | SeveralBalls { .. }
            )
    )
}
