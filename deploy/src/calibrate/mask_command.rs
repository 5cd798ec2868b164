//! `covers check mask`: checks that the mask hides the arm.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use envs::embodiments::Arm;
use serde_json::{Value, json};

use crate::DeployError;
use experiments::RunError;
use experiments::cli::say;
use learner::disk::{LocalDisk, replace, try_out};

use super::mask::MaskCheck;
use super::poses::poses;
use crate::deployment::Deployment;
use crate::options::{RobotKind, SiteOptions};
use crate::rig::{Rig, Trial};
use crate::settings::VisionSettings;
use crate::simulated::SimulatedRig;

/// Options of `covers check mask`: the policies, the robot and the outputs.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Example: covers check mask assets/pretrained-robot \
                        --calibration calibration.json --pictures masks")]
pub struct MaskOptions {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub site: SiteOptions,
    /// Folder for a picture (PNG) of each pose: green for mask and arm, red for the arm alone, blue
    /// for the mask alone.
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
    /// Print one JSON object instead of a table.
    #[arg(long)]
    pub json: bool,
}

impl MaskOptions {
    /// Runs the check and prints a row for each pose to `out`. Returns `true` if the mask holds.
    ///
    /// # Errors
    /// As [`MaskCheck::measure`]; folders and an `out` that cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<bool, DeployError> {
        let settings = self.site.rig.settings()?;
        let deployment = self.site.deployment(settings.vision)?;
        let RobotKind::KinovaSim = self.site.rig.robot;
        let mut rig = SimulatedRig::new(settings.simulation, *deployment.camera())?;
        let arm = rig.arm().clone();
        self.check(&deployment, &mut rig, &arm, out)
    }

    /// Runs the check on your own rig; `arm` is the model of its robot. `--faults` has no effect.
    ///
    /// # Errors
    /// As [`MaskOptions::run`], and `--fault`, which only a simulated rig can set.
    pub fn run_on(
        &self,
        rig: &mut dyn Rig,
        arm: &Arm,
        out: &mut impl Write,
    ) -> Result<bool, DeployError> {
        self.site.rig.refuse_faults([])?;
        let deployment = self.site.deployment(VisionSettings::default())?;
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
        let trial = Trial::on_empty_table(self.site.rig.seed);
        let check = MaskCheck::measure(deployment, rig, arm, &poses(arm), &trial);
        let check = self.site.camera.named(check)?;
        say(out, &if self.json { object(&check).to_string() } else { table(&check) })?;
        if let Some(folder) = &self.pictures {
            write(&check, folder)?;
        }
        Ok(check.holds())
    }
}

/// Creates the folder if there is none, and checks that it can be written to.
fn prepare(folder: &Path) -> Result<(), DeployError> {
    std::fs::create_dir_all(folder).map_err(|error| RunError::write(folder, error))?;
    Ok(try_out(&LocalDisk, &picture(folder, 1))?)
}

/// Returns the path of a pose's picture.
fn picture(folder: &Path, pose: usize) -> PathBuf {
    folder.join(format!("pose-{pose:02}.png"))
}

fn write(check: &MaskCheck, folder: &Path) -> Result<(), DeployError> {
    for (row, drawn) in check.rows.iter().zip(&check.pictures) {
        let path = picture(folder, row.pose);
        let png = drawn.to_png().map_err(|error| RunError::write(&path, error))?;
        replace(&LocalDisk, &path, &png)?;
    }
    Ok(())
}

/// Returns the result as a JSON object.
pub(super) fn object(check: &MaskCheck) -> Value {
    json!({
        "rows": check.rows,
        "left_out": check.left_out,
        "overlap": check.overlap(),
        "holds": check.holds(),
    })
}

fn table(check: &MaskCheck) -> String {
    let mut lines = vec!["pose  overlap  arm outside  mask over table".to_owned()];
    lines.extend(check.rows.iter().map(|row| {
        format!(
            "{:>4}  {:>7.2}  {:>9.1} %  {:>13.1} %",
            row.pose,
            row.overlap,
            100.0 * row.outside,
            100.0 * row.spare
        )
    }));
    let left_out = check.left_out.iter();
    lines.extend(left_out.map(|left| format!("pose {} was left out: {}", left.pose, left.why)));
    let verdict = if check.holds() { "holds" } else { "DOES NOT HOLD" };
    lines.push(format!(
        "the mask {}: at most {:.0} % of the arm may be outside in any pose, the mean overlap, \
         {:.2}, must be at least {}, and the poses seen, {}, at least {}",
        verdict,
        100.0 * MaskCheck::LARGEST_OUTSIDE,
        check.overlap(),
        MaskCheck::LEAST_OVERLAP,
        check.rows.len(),
        MaskCheck::MIN_POSES
    ));
    lines.join("\n")
}
