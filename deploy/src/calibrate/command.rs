//! `covers calibrate`: finds the pose of the camera.

use std::io::Write;
use std::path::PathBuf;
use std::str::FromStr;

use clap::Args;
use envs::Camera;
use envs::embodiments::Arm;
use glam::DVec3;
use inpainting::{
    BallOffsetInHand, CalibrationBall, CameraCalibration, FocalLengthEstimate, HandEyeCalibration,
    HandEyeSettings, HandEyeUncertainty,
};
use serde_json::{Value, json};

use crate::{DeployError, plausibility};
use experiments::RunError;
use experiments::cli::print_escaped;
use learner::disk::{LocalDisk, check_path_writable};

use super::camera_file::read_camera_intrinsics;
use super::file::CameraCalibrationFile;
use super::measure::{CameraCalibrationResult, CameraCalibrationSettings, calibrate_camera};
use super::poses::calibration_poses;
use crate::faults::SimulatedFault;
use crate::options::RigOptions;
use crate::rig::{Rig, Trial};
use crate::simulated::{SimulatedRig, SimulatedRigSettings};

/// Options of `covers calibrate`: the robot, the ball and the file.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Example: covers calibrate --robot kinova-sim --fault position-error=30 \
                        --out calibration.json")]
pub struct CalibrateOptions {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub rig: RigOptions,
    /// File to write, for `covers deploy --calibration`.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Position of the ball's centre in the frame of the hand's link (mm), as 129.9,-0.1,-170.2
    /// (default: it is estimated, too).
    #[arg(long = "offset", value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub ball_offset_mm: Option<NumberTriple>,
    /// Accuracy of the ball's position by the arm's joints (mm, one standard deviation). A pose
    /// that is off by more than four times as much is left out.
    #[arg(long, value_name = "MM", default_value_t = 2.5)]
    pub arm_accuracy: f64,
    /// YAML file of OpenCV or ROS (`camera_info`) with the camera's intrinsics and lens, in place
    /// of the rig's own.
    #[arg(long = "camera", value_name = "FILE")]
    pub camera_file: Option<PathBuf>,
    /// Estimate the focal lengths, too, starting from those that are given.
    #[arg(long)]
    pub estimate_focal: bool,
    /// Colour of the ball in the picture: red, green and blue, each 0 to 255.
    #[arg(long = "color", value_name = "R,G,B", default_value = "255,0,255")]
    pub ball_color: NumberTriple,
    /// Print the result as one JSON object, in the last line.
    #[arg(long)]
    pub json: bool,
}

/// Three numbers, parsed from text such as `1,2.5,-3`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NumberTriple(pub [f64; 3]);

impl FromStr for NumberTriple {
    type Err = DeployError;

    fn from_str(text: &str) -> Result<Self, DeployError> {
        let numbers: Result<Vec<f64>, _> = text.split(',').map(str::parse).collect();
        let numbers = numbers.unwrap_or_default();
        let finite = numbers.iter().all(|number| number.is_finite());
        match (<[f64; 3]>::try_from(numbers), finite) {
            (Ok(numbers), true) => Ok(Self(numbers)),
            _ => Err(RunError::invalid("three numbers", text, "numbers as 1,2.5,-3").into()),
        }
    }
}

impl CalibrateOptions {
    /// Calibrates the camera of a simulated rig, writes the calibration file and prints the result
    /// with its uncertainty to `out`.
    ///
    /// # Errors
    /// As [`calibrate_camera`]; a file and an `out` that cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<(), DeployError> {
        let settings = self.simulation()?;
        let mut rig = SimulatedRig::new_with_calibration_ball(
            settings,
            Camera::default(),
            self.rig.simulated_robot(),
        )?;
        let arm = rig.arm().clone();
        let calibrated = self.calibrate_on(&mut rig, &arm, out)?;
        if self.json {
            return Ok(());
        }
        let [place, angle] =
            distance_mm_and_angle_deg(&calibrated.estimate.calibration, &rig.true_calibration());
        let simulated = format!(
            "the true simulated camera is {place:.1} mm and {angle:.2} degrees from this result"
        );
        Ok(print_escaped(out, &simulated)?)
    }

    /// Calibrates the camera of your own rig, writes the calibration file and prints the result to
    /// `out`; `arm` is the model of the rig's robot. `--faults` has no effect.
    ///
    /// # Errors
    /// As [`CalibrateOptions::run`], and `--robot` and `--fault`, which are for a simulated rig
    /// alone.
    pub fn run_on_rig(
        &self,
        rig: &mut dyn Rig,
        arm: &Arm,
        out: &mut impl Write,
    ) -> Result<CameraCalibrationResult, DeployError> {
        self.rig.reject_simulation_options([])?;
        self.calibrate_on(rig, arm, out)
    }

    pub(super) fn calibrate_on(
        &self,
        rig: &mut dyn Rig,
        arm: &Arm,
        out: &mut impl Write,
    ) -> Result<CameraCalibrationResult, DeployError> {
        let settings = self.settings(&rig.calibration())?;
        // the arm moves for minutes, so check first that the file can be written
        check_path_writable(&LocalDisk, &self.out)?;
        let trial = Trial::on_empty_table(self.rig.seed);
        let calibrated = calibrate_camera(rig, arm, &settings, &calibration_poses(arm), &trial)?;
        let refusal = refusal(&calibrated.estimate.calibration, rig);
        let result = if self.json {
            object(&calibrated, self.estimate_focal, refusal.as_deref()).to_string()
        } else {
            text(&calibrated, self.estimate_focal, refusal.as_deref())
        };
        // the file first: a closed standard output must not cost it
        CameraCalibrationFile::write(&calibrated.estimate.calibration, &self.out)?;
        print_escaped(out, &result)?;
        Ok(calibrated)
    }

    /// Returns the settings of the simulated rig.
    ///
    /// # Errors
    /// [`RunError::InvalidSetting`] for a fault of the mask, which a calibration does not use.
    fn simulation(&self) -> Result<SimulatedRigSettings, DeployError> {
        if self.rig.fault_amounts.iter().any(|of| of.fault == SimulatedFault::MaskMargin) {
            return Err(RunError::invalid(
                "fault",
                SimulatedFault::MaskMargin.name(),
                "a fault of the camera or the arm: a calibration makes no mask",
            )
            .into());
        }
        Ok(self.rig.settings()?.simulation)
    }

    /// Returns the settings for a rig whose own calibration is `known`.
    fn settings(
        &self,
        known: &CameraCalibration,
    ) -> Result<CameraCalibrationSettings, DeployError> {
        let levels = self.ball_color.0;
        let is_level = |level: &f64| (0.0..=255.0).contains(level) && level.fract() == 0.0;
        if !levels.iter().all(is_level) {
            return Err(RunError::invalid(
                "color",
                format!("{levels:?}"),
                "three whole levels of 0 to 255",
            )
            .into());
        }
        let camera = self.camera_file.as_deref().map(|path| {
            let (intrinsics, distortion) = read_camera_intrinsics(path)?;
            let [size, expected] = [intrinsics, known.intrinsics].map(|of| (of.width, of.height));
            if size != expected {
                let problem = format!(
                    "it is of pictures of {} x {} pixels, but the rig's are {} x {}",
                    size.0, size.1, expected.0, expected.1
                );
                return Err(RunError::damaged_file(path, problem));
            }
            let checked = CameraCalibration { intrinsics, distortion, ..*known };
            checked.check().map_err(RunError::read_error_mapper(path))?;
            Ok((intrinsics, distortion))
        });
        // millimetres on the command line, metres inside
        let offset = self.ball_offset_mm.map(|NumberTriple(place)| DVec3::from_array(place) / 1e3);
        Ok(CameraCalibrationSettings {
            ball: CalibrationBall { color: levels.map(|level| level as u8) },
            hand_eye: HandEyeSettings {
                arm_position_sd: self.arm_accuracy / 1e3,
                estimate_focal_length: self.estimate_focal,
                ..offset.map_or(BallOffsetInHand::Unknown, BallOffsetInHand::Known).into()
            },
            lens: camera.transpose()?,
        })
    }
}

/// Returns the reason for which `covers deploy` would reject the calibration on this rig, if any.
fn refusal(found: &CameraCalibration, rig: &dyn Rig) -> Option<String> {
    match plausibility::check_plausibility(found, &rig.trial_independent_calibration()) {
        Err(DeployError::ImplausibleCalibration { part, value, expected }) => {
            Some(format!("its {part} is {value}, expected {expected}"))
        }
        _ => None,
    }
}

/// Returns the distance between two cameras (mm) and the angle between them (degrees).
pub(crate) fn distance_mm_and_angle_deg(
    one: &CameraCalibration,
    other: &CameraCalibration,
) -> [f64; 2] {
    let [place, angle] = plausibility::distance_m_and_angle_deg(one, other);
    [1e3 * place, angle]
}

/// Formats a distance on the table (metres) in millimetres; `None` is a point off the table.
fn in_millimetres(distance: Option<f64>) -> String {
    distance.map_or_else(|| "nowhere".to_owned(), |metres| format!("{:.1} mm", 1e3 * metres))
}

fn millimetres(place: DVec3) -> [f64; 3] {
    (1e3 * place).to_array()
}

fn degrees(angle: DVec3) -> [f64; 3] {
    angle.to_array().map(f64::to_degrees)
}

fn uncertainty(of: &HandEyeUncertainty) -> Value {
    json!({
        "position_mm": millimetres(of.position_sd),
        "angle_degrees": degrees(of.angle_sd),
        "offset_mm": millimetres(of.ball_offset_sd),
    })
}

/// Returns the result of a camera calibration as a JSON object.
fn object(calibrated: &CameraCalibrationResult, estimated: bool, refusal: Option<&str>) -> Value {
    let found = &calibrated.estimate;
    let [moved, turned] = distance_mm_and_angle_deg(&found.calibration, &calibrated.previous);
    let residuals = found.residuals.iter().map(|of| {
        let on_table = of.table_distance_m.map(|metres| 1e3 * metres);
        json!({"pose": of.pose_number, "pixels": of.distance_px, "mm_on_table": on_table})
    });
    json!({
        "calibration": CameraCalibrationFile::from(&found.calibration),
        "ball_in_hand_mm": millimetres(found.ball_offset),
        "rms_pixels": found.rms_px(),
        "rms_mm_on_table": found.rms_on_table_m().map(|place| 1e3 * place),
        "residuals": residuals.collect::<Vec<_>>(),
        "sigma": uncertainty(&found.uncertainty),
        "sigma_of_a_pixel": uncertainty(&found.uncertainty_per_pixel),
        "focal_by_the_poses": found.focal_length.map(|focal| json!({
            "ratio": focal.ratio_to_given,
            "sigma": focal.ratio_sd,
        })),
        "focal_estimated": estimated,
        "moved_mm": moved,
        "turned_degrees": turned,
        "left_out": calibrated.skipped_poses,
        "refused_by_deploy": refusal,
    })
}

/// Formats the result of a camera calibration as text.
fn text(calibrated: &CameraCalibrationResult, estimated: bool, refusal: Option<&str>) -> String {
    let CameraCalibrationResult { previous, estimate: found, skipped_poses } = calibrated;
    let mut lines: Vec<String> = skipped_poses
        .iter()
        .map(|left| format!("pose {} was left out: {}", left.pose_number, left.reason))
        .collect();
    lines.push(residuals(found));
    lines.extend(estimates(found));
    lines.push(focal(found.focal_length, estimated));
    // small residuals do not show poses that determine the camera badly; this does
    let sensitivity = &found.uncertainty_per_pixel;
    lines.push(format!(
        "a pixel of noise would leave {:.1} mm and {:.2} degrees",
        1e3 * sensitivity.position_sd.length(),
        sensitivity.angle_sd.length().to_degrees()
    ));
    let [place, angle] = distance_mm_and_angle_deg(&found.calibration, previous);
    lines.push(format!(
        "the rig's earlier calibration was {place:.1} mm and {angle:.2} degrees from this result"
    ));
    lines.extend(refusal.map(|why| {
        format!(
            "`covers deploy` will refuse this file until the rig's own calibration is corrected: \
             {why}"
        )
    }));
    lines.join("\n")
}

/// Returns the line of text on the ball's residuals: their root mean square and the largest one.
fn residuals(found: &HandEyeCalibration) -> String {
    let worst = found.largest_residual().map_or_else(String::new, |worst| {
        let (pose, pixels, table) =
            (worst.pose_number, worst.distance_px, in_millimetres(worst.table_distance_m));
        format!("; at most {pixels:.2}, {table}, in pose {pose}")
    });
    format!(
        "{} poses; the ball is {:.2} pixels off (rms), {} on the table{worst}",
        found.residuals.len(),
        found.rms_px(),
        in_millimetres(found.rms_on_table_m())
    )
}

/// Returns the lines of text on the estimates with their standard deviations: the camera's position
/// and orientation, and the ball's position in the hand if it was estimated.
fn estimates(found: &HandEyeCalibration) -> Vec<String> {
    let position = |name: &str, values: DVec3, sigma: DVec3| {
        let values = millimetres(values).map(|value| format!("{value:.1}")).join(", ");
        let sigma = millimetres(sigma).map(|value| format!("{value:.2}")).join(", ");
        format!("{name} at {values} mm, give or take {sigma}")
    };
    let sigma = &found.uncertainty;
    let [right, down, forwards] = degrees(sigma.angle_sd);
    let mut lines = vec![
        position("camera", found.calibration.camera_position(), sigma.position_sd),
        format!(
            "turned as the file says, give or take {right:.3}, {down:.3}, {forwards:.3} degrees \
             about its axes right, down and forwards"
        ),
    ];
    // an offset that was given has no uncertainty
    if sigma.ball_offset_sd != DVec3::ZERO {
        lines.push(position("ball in the hand", found.ball_offset, sigma.ball_offset_sd));
    }
    lines
}

/// Returns the line of text on the estimated error of the focal lengths.
fn focal(found: Option<FocalLengthEstimate>, estimated: bool) -> String {
    match found {
        Some(FocalLengthEstimate { ratio_to_given: ratio, ratio_sd: sigma }) => format!(
            "{} {:.1} % {}, give or take {:.1}",
            if estimated {
                "the focal lengths were estimated:"
            } else {
                "that holds for the focal lengths that were given; the poses alone would put them"
            },
            1e2 * (ratio - 1.0).abs(),
            if ratio < 1.0 { "lower" } else { "higher" },
            1e2 * sigma
        ),
        None => "that holds for the focal lengths that were given, which the poses do not tell"
            .to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dry_rig::dry_rig;

    #[test]
    fn three_numbers_are_read_or_refused() {
        let triple: NumberTriple = "1,2.5,-3".parse().unwrap();
        assert_eq!(triple, NumberTriple([1.0, 2.5, -3.0]));
        for text in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,NaN", "1,2,inf"] {
            let message = text.parse::<NumberTriple>().unwrap_err().to_string();
            assert!(message.contains("1,2.5,-3"), "{message}");
        }
    }

    #[test]
    fn a_file_that_deploy_will_refuse_is_told() {
        let rig = dry_rig(Ok);
        let previous = rig.calibration();
        let mut calibration = previous;
        assert_eq!(refusal(&calibration, &rig), None);
        calibration.extrinsics.translation.x += 0.2;
        let reason = refusal(&calibration, &rig).unwrap();
        assert!(reason.contains("its position is ") && reason.contains("0.15 m"), "{reason}");
        let certain = HandEyeUncertainty {
            position_sd: DVec3::ZERO,
            angle_sd: DVec3::ZERO,
            ball_offset_sd: DVec3::ZERO,
        };
        let estimate = HandEyeCalibration {
            calibration,
            ball_offset: DVec3::ZERO,
            residuals: Vec::new(),
            outliers: Vec::new(),
            uncertainty: certain,
            focal_length: None,
            uncertainty_per_pixel: certain,
        };
        let calibrated = CameraCalibrationResult { previous, estimate, skipped_poses: Vec::new() };
        let told = text(&calibrated, false, Some(&reason));
        let last = told.lines().last().unwrap();
        assert!(last.contains("will refuse this file") && last.ends_with(&reason), "{told}");
        assert_eq!(object(&calibrated, false, Some(&reason))["refused_by_deploy"], reason);
    }
}
