//! Check of the arm's mask, which follows from forward kinematics, against pictures of the arm.

use envs::embodiments::Arm;
use inpainting::MIN_CALIBRATION_POSES;
use robots::Pose;
use serde::Serialize;

use crate::DeployError;
use experiments::sheet::Picture;

use super::approach::ArmStateAtRest;
use super::measure::{SkippedPose, capture_in_pose, concerns_one_pose};
use super::overlay::mask_overlay;
use crate::deployment::Deployment;
use crate::observer::RigPerception;
use crate::rig::{Rig, Trial, stop_after};

/// Minimum difference (levels of 255) from the empty table of a pixel that shows the arm: four
/// standard deviations of the noise of the difference of two pictures.
const DIFFERENT: u8 = 18;
/// Minimum number of differing pixels in the 3 x 3 pixels around one for it to show the arm.
const MAJORITY: usize = 5;

/// Comparison of the computed mask with the arm in a picture, in one pose of the arm, by pixels of
/// the rectified picture, which are finer than those of the policy's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MaskComparison {
    /// Number of the pose of the arm, counted from 1.
    #[serde(rename = "pose")]
    pub pose_number: usize,
    /// Intersection over union of mask and arm.
    #[serde(rename = "overlap")]
    pub iou: f64,
    /// Share of the arm that the mask does not cover.
    #[serde(rename = "outside")]
    pub uncovered_share: f64,
    /// Share of the mask that covers the table instead of the arm.
    #[serde(rename = "spare")]
    pub excess_share: f64,
}

/// Comparison of the computed mask with the arm in pictures, in several poses of the arm.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MaskCheck {
    /// Comparisons of mask and arm, one for each pose.
    pub comparisons: Vec<MaskComparison>,
    /// Pictures with mask and arm in colours: green for both, red for the arm alone, blue for the
    /// mask alone.
    pub overlays: Vec<Picture>,
    /// Poses of the mask check that were skipped, with the reasons.
    pub skipped_poses: Vec<SkippedPose>,
}

/// Sets the table up; returns the perception of the rig and a picture of the empty table.
fn set_up_observer(
    deployment: &Deployment,
    rig: &mut dyn Rig,
    arm: &Arm,
    trial: &Trial,
) -> Result<(RigPerception, Vec<u8>), DeployError> {
    let set_up = rig.set_up(trial).map_err(|source| DeployError::Rig { source })?;
    let start = rig.state()?;
    let observer = deployment.observer(rig, arm, &set_up, start)?;
    Ok((observer, set_up.background))
}

impl MaskCheck {
    /// Maximum share of the arm's pixels outside of the mask, in any pose, for the check to pass.
    pub const MAX_UNCOVERED_ARM_SHARE: f64 = 0.02;
    /// Minimum mean intersection over union of mask and arm; below it the mask is far too large.
    pub const MIN_MEAN_IOU: f64 = 0.5;
    /// Minimum number of poses of the arm that a check must compare to pass.
    pub const MIN_CHECKED_POSES: usize = MIN_CALIBRATION_POSES;

    /// Moves the arm to `poses` over the table of `trial`, which should be empty, and compares the
    /// mask that `deployment` would use with the pictures. The robot is stopped at the end and
    /// before any error is returned.
    ///
    /// # Errors
    /// [`DeployError::ImplausibleCalibration`], before the arm moves; [`DeployError::Rig`],
    /// [`DeployError::Robot`], [`DeployError::StalePicture`], [`DeployError::CameraClockAhead`];
    /// errors of the perception.
    pub fn run_on_rig(
        deployment: &Deployment,
        rig: &mut dyn Rig,
        arm: &Arm,
        poses: &[Pose],
        trial: &Trial,
    ) -> Result<Self, DeployError> {
        deployment.check_calibration(rig)?;
        let size = deployment.training_camera().size;
        let started = set_up_observer(deployment, rig, arm, trial);
        let measured = started.and_then(|(observer, background)| {
            let seen = vec![0; 3 * size * size];
            Self::visit_all(rig, arm, poses, observer, background, seen)
        });
        stop_after(rig, measured)
    }

    /// Visits all poses of the hand and compares mask and arm. `picture` and `seen` are buffers for
    /// the pictures of camera and policy.
    fn visit_all(
        rig: &mut dyn Rig,
        arm: &Arm,
        poses: &[Pose],
        mut observer: RigPerception,
        mut picture: Vec<u8>,
        mut seen: Vec<u8>,
    ) -> Result<Self, DeployError> {
        let mut check = Self::default();
        for (number, target) in poses.iter().enumerate() {
            let pose = number + 1;
            match capture_in_pose(rig, arm, target, &mut picture) {
                Ok(ArmStateAtRest { since, state }) => {
                    // pictures come late: the next one may be of any time since the hand came to
                    // rest
                    observer.record_state(since, state.clone());
                    observer.record_state(rig.now(), state);
                    observer.fetch_picture(rig)?;
                    observer.write_picture_without_arm(arm, &mut seen)?;
                    check.add(pose, &observer);
                }
                Err(error) if concerns_one_pose(&error) => {
                    // the arm may still be on its way
                    rig.stop()?;
                    let reason = error.to_string();
                    check.skipped_poses.push(SkippedPose { pose_number: pose, reason });
                }
                Err(error) => return Err(error),
            }
        }
        Ok(check)
    }

    /// Compares the last picture's mask with the pixels that differ from the empty table.
    fn add(&mut self, pose: usize, observer: &RigPerception) {
        let perception = observer.perception();
        let width = perception.rectified_camera().intrinsics.width;
        let arm = smoothed(
            &perception
                .difference_from_background()
                .map(|levels| levels >= DIFFERENT)
                .collect::<Vec<_>>(),
            width,
        );
        self.comparisons.push(row(pose, perception.arm_mask(), &arm));
        self.overlays.push(mask_overlay(perception, &arm));
    }

    /// Returns the mean intersection over union of mask and arm over all poses, in `[0, 1]`; 0
    /// without poses.
    pub fn mean_iou(&self) -> f64 {
        let overlaps = self.comparisons.iter().map(|row| row.iou);
        overlaps.sum::<f64>() / self.comparisons.len().max(1) as f64
    }

    /// Returns `true` if the mask was checked in enough poses, leaves at most 2 % of the arm
    /// uncovered in each, and has a mean overlap of at least 0.5.
    pub fn passes(&self) -> bool {
        self.comparisons.len() >= Self::MIN_CHECKED_POSES && self.passes_in_visited_poses()
    }

    /// Returns `true` if the mask leaves at most 2 % of the arm uncovered in each compared pose,
    /// and has a mean overlap of at least 0.5, however few poses were compared.
    pub(super) fn passes_in_visited_poses(&self) -> bool {
        let hidden = |row: &MaskComparison| row.uncovered_share <= Self::MAX_UNCOVERED_ARM_SHARE;
        self.comparisons.iter().all(hidden) && self.mean_iou() >= Self::MIN_MEAN_IOU
    }
}

/// Majority filter over 3 x 3 pixels: removes single pixels, which are noise, and fills small
/// holes.
fn smoothed(differs: &[bool], width: usize) -> Vec<bool> {
    let height = differs.len() / width;
    let around = |place: usize, count: usize| place.saturating_sub(1)..(place + 2).min(count);
    let says = |index: usize| {
        let (row, column) = (index / width, index % width);
        let rows = around(row, height);
        let pixels = rows.flat_map(|r| around(column, width).map(move |c| r * width + c));
        pixels.filter(|&pixel| differs[pixel]).count() >= MAJORITY
    };
    (0..differs.len()).map(says).collect()
}

fn row(pose: usize, mask: &[bool], arm: &[bool]) -> MaskComparison {
    let count = |holds: fn(bool, bool) -> bool| {
        let pairs = mask.iter().zip(arm);
        pairs.filter(|(masked, shown)| holds(**masked, **shown)).count() as f64
    };
    // a share of no pixels is 0
    let share = |part: f64, all: f64| part / all.max(1.0);
    MaskComparison {
        pose_number: pose,
        iou: share(count(|m, a| m && a), count(|m, a| m || a)),
        uncovered_share: share(count(|m, a| a && !m), count(|_, a| a)),
        excess_share: share(count(|m, a| m && !a), count(|m, _| m)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_of_the_arm_and_of_the_mask() {
        let mask = [true, true, true, false, false, false];
        let arm = [true, true, false, true, false, false];
        let row = row(3, &mask, &arm);
        assert_eq!((row.pose_number, row.iou), (3, 0.5));
        assert!((row.uncovered_share - 1.0 / 3.0).abs() < 1e-12);
        assert!((row.excess_share - 1.0 / 3.0).abs() < 1e-12);
        let nothing = super::row(1, &[false; 4], &[false; 4]);
        assert_eq!((nothing.iou, nothing.uncovered_share, nothing.excess_share), (0.0, 0.0, 0.0));
    }

    #[test]
    fn a_check_holds_where_no_pose_shows_the_arm() {
        let row = |uncovered_share, iou| MaskComparison {
            pose_number: 1,
            iou,
            uncovered_share,
            excess_share: 0.3,
        };
        let holds = |rows: &[MaskComparison]| {
            let comparisons = rows.to_vec();
            MaskCheck { comparisons, ..MaskCheck::default() }.passes()
        };
        let mut rows = vec![row(0.0, 0.6); MaskCheck::MIN_CHECKED_POSES];
        rows[3] = row(0.02, 0.4);
        assert!(holds(&rows));
        assert!(!holds(&rows[1..]), "too little was seen");
        rows[3] = row(0.03, 0.6);
        assert!(!holds(&rows), "the arm shows");
        rows.fill(row(0.0, 0.4));
        assert!(!holds(&rows), "the mask hides the table");
        assert!(!holds(&[]), "nothing was seen");
    }

    #[test]
    fn single_pixels_are_noise() {
        let mut differs = vec![false; 49];
        differs[24] = true;
        assert!(smoothed(&differs, 7).iter().all(|differs| !differs));
        for row in 2..5 {
            differs[row * 7 + 2..row * 7 + 5].fill(true);
        }
        let smooth = smoothed(&differs, 7);
        assert!(smooth[24] && smooth[17] && !smooth[16] && !smooth[0]);
    }
}
