//! `covers check mask`: checks that the mask hides the arm.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use envs::embodiments::Arm;
use serde_json::{Value, json};

use crate::DeployError;
use experiments::RunError;
use experiments::cli::print_escaped;
use learner::disk::{LocalDisk, check_path_writable, write_atomically};

use super::mask::MaskCheck;
use super::poses::calibration_poses;
use crate::deployment::Deployment;
use crate::options::RunAndRigOptions;
use crate::rig::{Rig, Trial};
use crate::settings::VisionSettings;
use crate::simulated::SimulatedRig;

/// Options of `covers check mask`: the policies, the robot and the outputs.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Example: covers check mask assets/pretrained-robot \
                        --calibration calibration.json --pictures masks")]
pub struct CheckMaskOptions {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub run_and_rig: RunAndRigOptions,
    /// Folder for a picture (PNG) of each pose: green for mask and arm, red for the arm alone, blue
    /// for the mask alone.
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
    /// Print one JSON object instead of a table.
    #[arg(long)]
    pub json: bool,
}

impl CheckMaskOptions {
    /// Checks the mask on a simulated rig, prints a row for each pose of the arm to `out`, and
    /// returns `true` if the mask hides the arm.
    ///
    /// # Errors
    /// As [`MaskCheck::run_on_rig`]; folders and an `out` that cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<bool, DeployError> {
        let settings = self.run_and_rig.rig.settings()?;
        let deployment = self.run_and_rig.load_deployment(settings.vision)?;
        let robot = self.run_and_rig.rig.simulated_robot();
        let camera = *deployment.training_camera();
        let mut rig = SimulatedRig::new(settings.simulation, camera, robot)?;
        let arm = rig.arm().clone();
        self.check(&deployment, &mut rig, &arm, out)
    }

    /// Checks the mask on your own rig, prints a row for each pose of the arm to `out`, and returns
    /// `true` if the mask hides the arm; `arm` is the model of the rig's robot. `--faults` has no
    /// effect.
    ///
    /// # Errors
    /// As [`CheckMaskOptions::run`], and `--robot` and `--fault`, which are for a simulated rig
    /// alone.
    pub fn run_on_rig(
        &self,
        rig: &mut dyn Rig,
        arm: &Arm,
        out: &mut impl Write,
    ) -> Result<bool, DeployError> {
        self.run_and_rig.rig.reject_simulation_options([])?;
        let deployment = self.run_and_rig.load_deployment(VisionSettings::default())?;
        self.check(&deployment, rig, arm, out)
    }

    fn check(
        &self,
        deployment: &Deployment,
        rig: &mut dyn Rig,
        arm: &Arm,
        out: &mut impl Write,
    ) -> Result<bool, DeployError> {
        // the arm moves for minutes, so check first that the files can be written
        self.pictures.as_deref().map_or(Ok(()), prepare)?;
        let trial = Trial::on_empty_table(self.run_and_rig.rig.seed);
        let check = MaskCheck::run_on_rig(deployment, rig, arm, &calibration_poses(arm), &trial);
        let check = self.run_and_rig.name_file_in_error(check)?;
        print_escaped(
            out,
            &if self.json { mask_check_json(&check).to_string() } else { table(&check) },
        )?;
        if let Some(folder) = &self.pictures {
            write(&check, folder)?;
        }
        Ok(check.passes())
    }
}

/// Creates the folder for the mask's pictures if needed, and checks that it can be written to.
fn prepare(folder: &Path) -> Result<(), DeployError> {
    std::fs::create_dir_all(folder).map_err(RunError::write_error_mapper(folder))?;
    Ok(check_path_writable(&LocalDisk, &picture(folder, 1))?)
}

fn picture(folder: &Path, pose: usize) -> PathBuf {
    folder.join(format!("pose-{pose:02}.png"))
}

fn write(check: &MaskCheck, folder: &Path) -> Result<(), DeployError> {
    for (row, drawn) in check.comparisons.iter().zip(&check.overlays) {
        let path = picture(folder, row.pose_number);
        let png = drawn.to_png().map_err(RunError::write_error_mapper(&path))?;
        write_atomically(&LocalDisk, &path, &png)?;
    }
    Ok(())
}

/// Returns the result of a mask check as a JSON object.
pub(super) fn mask_check_json(check: &MaskCheck) -> Value {
    json!({
        "rows": check.comparisons,
        "left_out": check.skipped_poses,
        "overlap": check.mean_iou(),
        "holds": check.passes(),
    })
}

fn table(check: &MaskCheck) -> String {
    let mut lines = vec!["pose  overlap  arm outside  mask over table".to_owned()];
    lines.extend(check.comparisons.iter().map(|row| {
        format!(
            "{:>4}  {:>7.2}  {:>9.1} %  {:>13.1} %",
            row.pose_number,
            row.iou,
            100.0 * row.uncovered_share,
            100.0 * row.excess_share
        )
    }));
    let left_out = check.skipped_poses.iter();
    lines.extend(
        left_out.map(|left| format!("pose {} was left out: {}", left.pose_number, left.reason)),
    );
    let verdict = if check.passes() { "holds" } else { "DOES NOT HOLD" };
    lines.push(format!(
        "the mask {}: at most {:.0} % of the arm may be outside in any pose, the mean overlap, \
         {:.2}, must be at least {}, and the poses seen, {}, at least {}",
        verdict,
        100.0 * MaskCheck::MAX_UNCOVERED_ARM_SHARE,
        check.mean_iou(),
        MaskCheck::MIN_MEAN_IOU,
        check.comparisons.len(),
        MaskCheck::MIN_CHECKED_POSES
    ));
    lines.join("\n")
}
