//! Holds the arm's mask, which forward kinematics make, to where the picture shows the arm.

use envs::carriers::Arm;
use inpainting::LEAST_POSES;
use robots::Pose;
use serde::Serialize;

use crate::DeployError;
use experiments::sheet::Picture;

use super::approach::Standing;
use super::measure::{LeftOut, is_of_the_pose, visit};
use super::overlay::overlay;
use crate::deployment::Deployment;
use crate::rig::{Rig, Trial, then_stop};
use crate::sight::Sight;

/// Levels of 255 from which on a pixel differs from the empty table: four deviations of the noise
/// of two pictures.
const DIFFERENT: u8 = 18;
/// Of a pixel and the eight around it, those that must differ.
const MAJORITY: usize = 5;

/// The mask of a pose beside the arm. The shares are of pixels of the policy's view.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MaskRow {
    /// Number of the pose, counted from 1.
    pub pose: usize,
    /// Pixels of mask and arm over pixels of mask or arm.
    pub overlap: f64,
    /// Share of the arm that the mask leaves in the picture.
    pub outside: f64,
    /// Share of the mask that hides table.
    pub spare: f64,
}

/// The mask in several poses.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MaskCheck {
    /// One for each pose.
    pub rows: Vec<MaskRow>,
    /// The pictures, with the mask and the arm in colours: green where they agree, red where the
    /// mask leaves the arm, blue where it hides table.
    pub pictures: Vec<Picture>,
    /// Poses that were left out.
    pub left_out: Vec<LeftOut>,
}

/// Sets the table; how the arm is seen there, and the picture of the empty table.
fn watch(
    deployment: &Deployment,
    rig: &mut dyn Rig,
    arm: &Arm,
    trial: &Trial,
) -> Result<(Sight, Vec<u8>), DeployError> {
    let set_up = rig.set_up(trial);
    let set_up = set_up.map_err(|source| DeployError::Rig { source })?;
    let start = rig.state()?;
    let sight = deployment.sight(rig, arm, &set_up, start)?;
    Ok((sight, set_up.background))
}

impl MaskCheck {
    /// Largest part of the arm in any pose that a mask may leave in the picture.
    pub const LARGEST_OUTSIDE: f64 = 0.02;
    /// Smallest mean overlap: below it the mask hides far more than the arm.
    pub const LEAST_OVERLAP: f64 = 0.5;
    /// Fewest poses that a mask is judged by.
    pub const LEAST_POSES: usize = LEAST_POSES;

    /// Lets the arm go to `poses` over the table of `trial`, which should be empty, and holds the
    /// mask that `deployment` would use to the picture. The robot is told to stop at the end, and
    /// before an error is returned.
    ///
    /// # Errors
    /// [`DeployError::OtherCamera`], before the arm moves; [`DeployError::Rig`],
    /// [`DeployError::Robot`], [`DeployError::StalePicture`], [`DeployError::PictureOfTheFuture`];
    /// what perception says of the camera.
    pub fn measure(
        deployment: &Deployment,
        rig: &mut dyn Rig,
        arm: &Arm,
        poses: &[Pose],
        trial: &Trial,
    ) -> Result<Self, DeployError> {
        deployment.check_calibration(rig)?;
        let size = deployment.camera().size;
        let watched = watch(deployment, rig, arm, trial);
        let measured = watched.and_then(|(sight, background)| {
            Self::visit_all(rig, arm, poses, (sight, background, vec![0; 3 * size * size]))
        });
        then_stop(rig, measured)
    }

    fn visit_all(
        rig: &mut dyn Rig,
        arm: &Arm,
        poses: &[Pose],
        (mut sight, mut picture, mut seen): (Sight, Vec<u8>, Vec<u8>),
    ) -> Result<Self, DeployError> {
        let mut check = Self::default();
        for (number, target) in poses.iter().enumerate() {
            let pose = number + 1;
            match visit(rig, arm, target, &mut picture) {
                Ok(Standing { since, state }) => {
                    // pictures come late: the next one may be of any time since it stands
                    sight.note(since, state.clone());
                    sight.note(rig.now(), state);
                    sight.shoot(rig)?;
                    sight.paint(arm, &mut seen)?;
                    check.add(pose, &sight);
                }
                Err(error) if is_of_the_pose(&error) => {
                    rig.stop()?;
                    let why = error.to_string();
                    check.left_out.push(LeftOut { pose, why });
                }
                Err(error) => return Err(error),
            }
        }
        Ok(check)
    }

    /// Compares the mask of the last picture with where it differs from the empty table.
    fn add(&mut self, pose: usize, sight: &Sight) {
        let perception = sight.perception();
        let width = perception.view().intrinsics.width;
        let arm = smoothed(
            &perception.difference().map(|levels| levels >= DIFFERENT).collect::<Vec<_>>(),
            width,
        );
        self.rows.push(row(pose, perception.mask(), &arm));
        self.pictures.push(overlay(perception, &arm));
    }

    /// The mean overlap.
    pub fn overlap(&self) -> f64 {
        let overlaps = self.rows.iter().map(|row| row.overlap);
        overlaps.sum::<f64>() / self.rows.len().max(1) as f64
    }

    /// Whether the mask was seen in enough poses, leaves at most 2 % of the arm in any, and
    /// overlaps with it by at least half on average.
    pub fn holds(&self) -> bool {
        self.rows.len() >= Self::LEAST_POSES && self.fits()
    }

    /// Whether the mask holds in the poses that were seen, however few.
    pub(super) fn fits(&self) -> bool {
        let hidden = |row: &MaskRow| row.outside <= Self::LARGEST_OUTSIDE;
        self.rows.iter().all(hidden) && self.overlap() >= Self::LEAST_OVERLAP
    }
}

/// Where most pixels of a neighbourhood say so: noise is alone.
fn smoothed(differs: &[bool], width: usize) -> Vec<bool> {
    let height = differs.len() / width;
    let around = |place: usize, count: usize| place.saturating_sub(1)..(place + 2).min(count);
    let says = |index: usize| {
        let (row, column) = (index / width, index % width);
        let rows = around(row, height);
        let pixels = rows.flat_map(|row| around(column, width).map(move |c| row * width + c));
        pixels.filter(|&pixel| differs[pixel]).count() >= MAJORITY
    };
    (0..differs.len()).map(says).collect()
}

fn row(pose: usize, mask: &[bool], arm: &[bool]) -> MaskRow {
    let count = |holds: fn(bool, bool) -> bool| {
        let pairs = mask.iter().zip(arm);
        pairs.filter(|(mask, arm)| holds(**mask, **arm)).count() as f64
    };
    // of nothing, the share is zero
    let share = |part: f64, all: f64| part / all.max(1.0);
    MaskRow {
        pose,
        overlap: share(count(|mask, arm| mask && arm), count(|mask, arm| mask || arm)),
        outside: share(count(|mask, arm| arm && !mask), count(|_, arm| arm)),
        spare: share(count(|mask, arm| mask && !arm), count(|mask, _| mask)),
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
        assert_eq!((row.pose, row.overlap), (3, 0.5));
        assert!((row.outside - 1.0 / 3.0).abs() < 1e-12);
        assert!((row.spare - 1.0 / 3.0).abs() < 1e-12);
        let nothing = super::row(1, &[false; 4], &[false; 4]);
        assert_eq!((nothing.overlap, nothing.outside, nothing.spare), (0.0, 0.0, 0.0));
    }

    #[test]
    fn a_check_holds_where_no_pose_shows_the_arm() {
        let row = |outside, overlap| MaskRow { pose: 1, overlap, outside, spare: 0.3 };
        let holds = |rows: &[MaskRow]| {
            let rows = rows.to_vec();
            MaskCheck { rows, ..MaskCheck::default() }.holds()
        };
        let mut rows = vec![row(0.0, 0.6); MaskCheck::LEAST_POSES];
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
