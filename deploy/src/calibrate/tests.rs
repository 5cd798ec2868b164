//! Tests of the calibration and the mask's check on a simulated rig.

use envs::{Camera, Embodiment};
use glam::{DMat3, DVec3};
use inpainting::{
    BallOffsetInHand, CalibrationBall, CameraCalibration, Extrinsics, HandEyeSettings,
};
use robots::{Pose, Robot};

use super::calibration_poses;
use super::command::{CalibrateOptions, NumberTriple, distance_mm_and_angle_deg};
use super::file::CameraCalibrationFile;
use super::mask::MaskCheck;
use super::measure::{CameraCalibrationSettings, calibrate_camera};
use crate::dry_rig::{arm, dry_rig};
use crate::rig::Trial;
use crate::tests::pretrained;
use crate::{DeployError, FaultPreset, RigOptions, SimulatedRig, SimulatedRigSettings};

pub(super) const SETTINGS: CameraCalibrationSettings = CameraCalibrationSettings {
    ball: CalibrationBall { color: [255, 0, 255] },
    hand_eye: HandEyeSettings {
        ball_offset: BallOffsetInHand::Unknown,
        arm_position_sd: 0.0025,
        estimate_focal_length: false,
    },
    lens: None,
};

/// With all other faults, a lens that nobody knows among them. The file says what was found.
#[test]
fn a_camera_that_is_30_mm_and_3_degrees_off_is_found() {
    let name = format!("covers-found-{}.json", std::process::id());
    let faults = ["position-error=30", "angle-error=3"].map(|fault| fault.parse().unwrap());
    let options = CalibrateOptions {
        rig: RigOptions {
            robot: None,
            seed: 1000,
            faults: FaultPreset::Nominal,
            fault_amounts: faults.to_vec(),
        },
        out: std::env::temp_dir().join(name),
        ball_offset_mm: None,
        arm_accuracy: 2.5,
        camera_file: None,
        estimate_focal: false,
        ball_color: NumberTriple([255.0, 0.0, 255.0]),
        json: true,
    };
    let settings = options.rig.settings().unwrap().simulation;
    let mut rig = SimulatedRig::new_with_calibration_ball(
        settings,
        Camera::default(),
        Embodiment::KINOVA_GEN3,
    )
    .unwrap();
    let (arm, truth) = (rig.arm().clone(), rig.true_calibration());
    let mut out = Vec::new();
    let calibrated = options.calibrate_on(&mut rig, &arm, &mut out).unwrap();
    let read = CameraCalibrationFile::read(&options.out);
    std::fs::remove_file(&options.out).unwrap();
    let [place, angle] = distance_mm_and_angle_deg(&calibrated.previous, &truth);
    assert!((place - 30.0).abs() < 1e-6 && (angle - 3.0).abs() < 1e-6);
    let [place_left, angle_left] = distance_mm_and_angle_deg(&read.unwrap(), &truth);
    assert!(place_left < 3.0 && angle_left < 0.1, "{place_left} mm, {angle_left} degrees");
    let told: serde_json::Value = serde_json::from_slice(&out).unwrap();
    assert!(told["rms_pixels"].as_f64().unwrap() < 0.2, "{told}");
    let residuals = told["residuals"].as_array().unwrap().len();
    assert_eq!((calibrated.skipped_poses.len(), residuals), (0, 14));
    assert!(told["refused_by_deploy"].is_null(), "{told}");
}

/// A mask by the true camera holds, and one by a camera that is 30 mm and 3 degrees off does not.
#[test]
fn masks_are_held_to_the_picture() {
    let mut rig = SimulatedRig::new(
        SimulatedRigSettings::NOMINAL_FAULTS,
        Camera::default(),
        Embodiment::KINOVA_GEN3,
    )
    .unwrap();
    let (arm, truth) = (rig.arm().clone(), rig.true_calibration());
    let rotation = DMat3::from_rotation_x(3_f64.to_radians()) * truth.extrinsics.rotation;
    let position = truth.camera_position() + 0.03 * DVec3::X;
    let wrong = CameraCalibration {
        extrinsics: Extrinsics { rotation, translation: -(rotation * position) },
        ..truth
    };
    let (first, trial) = (&calibration_poses(&arm)[..1], Trial::on_empty_table(1000));
    for (camera, holds) in [(truth, true), (wrong, false)] {
        let deployment = pretrained("pretrained-robot", Some(camera));
        let check = MaskCheck::run_on_rig(&deployment, &mut rig, &arm, first, &trial).unwrap();
        assert_eq!((check.comparisons.len(), check.overlays.len()), (1, 1));
        assert_eq!(check.passes_in_visited_poses(), holds, "{:?}", check.comparisons);
        assert!(!check.passes(), "one pose is too few");
    }
}

/// The mask of the second pose is where the arm stands there, not where it was on its way.
#[test]
fn masks_do_not_lag_behind_late_pictures() {
    let checks = [0.0, 0.4].map(|latency| {
        let mut settings = SimulatedRigSettings::NO_FAULTS;
        settings.camera_imperfections.latency = latency;
        let mut rig =
            SimulatedRig::new(settings, Camera::default(), Embodiment::KINOVA_GEN3).unwrap();
        let deployment = pretrained("pretrained-robot", Some(rig.true_calibration()));
        let arm = rig.arm().clone();
        let (two, trial) = (&calibration_poses(&arm)[..2], Trial::on_empty_table(1000));
        MaskCheck::run_on_rig(&deployment, &mut rig, &arm, two, &trial).unwrap()
    });
    let [at_once, late] = checks.map(|check| check.comparisons[1]);
    for (one, other) in [
        (at_once.iou, late.iou),
        (at_once.uncovered_share, late.uncovered_share),
        (at_once.excess_share, late.excess_share),
    ] {
        assert!((one - other).abs() < 0.01, "{at_once:?} {late:?}");
    }
}

/// The error names the first pose that was left out, and why.
#[test]
fn balls_that_are_not_seen_and_poses_out_of_reach_are_told() {
    let (arm, mut rig) = (arm(), dry_rig(Ok));
    let tip = rig.state().unwrap().tip;
    let high = Pose { position: tip.position + DVec3::Z, ..tip };
    let trial = Trial::on_empty_table(0);
    for (poses, says) in
        [(vec![tip, high], "no ball of the colour"), (vec![high, tip], "cannot follow")]
    {
        let failed = calibrate_camera(&mut rig, &arm, &SETTINGS, &poses, &trial);
        let error = failed.unwrap_err();
        assert!(matches!(
            error,
            DeployError::TooFewSightings { sightings: 0, skipped_pose: 1, .. }
        ));
        let message = error.to_string();
        assert!(message.contains("at least 10") && message.contains(says), "{message}");
    }
}
