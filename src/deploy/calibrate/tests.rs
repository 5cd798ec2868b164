//! The camera of a simulated rig is found, and its mask is held to what it shows.

use std::path::Path;
use std::time::Duration;

use envs::{Camera, HAND_START};
use glam::{DMat3, DVec3};
use inpainting::{Ball, Calibration, Extrinsics, Offset};
use rl::BoxError;
use robots::{Command, ControlError, Pose, Robot, RobotState};

use super::super::rig::{Rig, SetUp, Trial, Verdict};
use super::command::{CalibrateOptions, Triple, apart};
use super::file::CalibrationFile;
use super::mask::MaskCheck;
use super::measure::{CalibrateSettings, calibrate};
use super::poses;
use crate::deploy::{
    Deployment, Faults, RigOptions, RobotKind, SightSettings, SimulatedRig, SimulationSettings,
};
use crate::error::CoversError;
use crate::runs::RunFolder;

const SETTINGS: CalibrateSettings = CalibrateSettings {
    ball: Ball {
        color: [255, 0, 255],
    },
    offset: Offset::Unknown,
};

/// With all other faults, a lens that nobody knows among them. The file says what was found.
#[test]
fn a_camera_that_is_30_mm_and_3_degrees_off_is_found() {
    let name = format!("covers-found-{}.json", std::process::id());
    let options = CalibrateOptions {
        rig: RigOptions {
            robot: RobotKind::KinovaSim,
            seed: 1000,
            faults: Faults::Nominal,
            fault: ["position-error=30", "angle-error=3"]
                .map(|fault| fault.parse().unwrap())
                .to_vec(),
        },
        out: std::env::temp_dir().join(name),
        offset: None,
        color: Triple([255.0, 0.0, 255.0]),
        json: true,
    };
    let (settings, _) = options.rig.settings().unwrap();
    let mut rig = SimulatedRig::with_ball(settings, Camera::default()).unwrap();
    let (arm, truth) = (rig.arm().clone(), rig.truth());
    let mut out = Vec::new();
    let calibrated = options.run_on(&mut rig, &arm, &mut out).unwrap();
    let read = CalibrationFile::read(&options.out);
    std::fs::remove_file(&options.out).unwrap();
    let [place, angle] = apart(&calibrated.before, &truth);
    assert!((place - 30.0).abs() < 1e-6 && (angle - 3.0).abs() < 1e-6);
    let [place, angle] = apart(&read.unwrap(), &truth);
    assert!(place < 3.0 && angle < 0.1, "{place} mm, {angle} degrees");
    let told: serde_json::Value = serde_json::from_slice(&out).unwrap();
    assert!(told["rms_pixels"].as_f64().unwrap() < 0.2, "{told}");
    let residuals = told["residuals"].as_array().unwrap().len();
    assert_eq!((calibrated.left_out.len(), residuals), (0, 14));
}

fn deployment(calibration: Calibration) -> Deployment {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/pretrained");
    let sight = SightSettings {
        calibration: Some(calibration),
        ..SightSettings::default()
    };
    Deployment::load(&RunFolder::open(&folder), sight).unwrap()
}

/// A mask by the true camera holds, and one by a camera that is 30 mm and 3 degrees off does not.
#[test]
fn masks_are_held_to_the_picture() {
    let mut rig = SimulatedRig::new(SimulationSettings::NOMINAL, Camera::default()).unwrap();
    let (arm, truth) = (rig.arm().clone(), rig.truth());
    let rotation = DMat3::from_rotation_x(3_f64.to_radians()) * truth.extrinsics.rotation;
    let position = truth.position() + 0.03 * DVec3::X;
    let wrong = Calibration {
        extrinsics: Extrinsics {
            rotation,
            translation: -(rotation * position),
        },
        ..truth
    };
    let (first, trial) = (&poses(&arm)[..1], Trial::on_empty_table(1000));
    for (camera, holds) in [(truth, true), (wrong, false)] {
        let deployment = deployment(camera);
        let check = MaskCheck::measure(&deployment, &mut rig, &arm, first, &trial).unwrap();
        assert_eq!((check.rows.len(), check.pictures.len()), (1, 1));
        assert_eq!(check.holds(), holds, "{:?}", check.rows);
    }
}

/// A rig whose arm is elsewhere than it should be, over a table that shows nothing.
struct Blank(RobotState);

impl Robot for Blank {
    fn state(&mut self) -> Result<RobotState, ControlError> {
        Ok(self.0.clone())
    }

    /// Nothing above a height is within reach.
    fn command(&mut self, command: &Command) -> Result<(), ControlError> {
        let tip = &mut self.0.tip;
        if command.twist.linear.z > 0.0 && tip.position.z > 0.24 {
            return Err(ControlError::OutOfReach {
                target: tip.position,
                reached: tip.position,
                distance: 0.1,
                angle: 0.0,
                joint: None,
            });
        }
        tip.position += 0.025 * command.twist.linear;
        let turn = glam::DQuat::from_scaled_axis(0.025 * command.twist.angular);
        tip.rotation = (turn * tip.rotation).normalize();
        Ok(())
    }

    fn stop(&mut self) -> Result<(), ControlError> {
        Ok(())
    }
}

impl Rig for Blank {
    fn set_up(&mut self, _: &Trial) -> Result<SetUp, BoxError> {
        Ok(SetUp {
            background: vec![100; 3 * 640 * 480],
            parked: self.0.clone(),
            goal: None,
        })
    }

    fn calibration(&self) -> Calibration {
        let rig = SimulatedRig::new(SimulationSettings::OFF, Camera::default());
        rig.unwrap().truth()
    }

    fn now(&self) -> Duration {
        Duration::ZERO
    }

    fn wait(&mut self, _: Duration) -> Result<(), BoxError> {
        Ok(())
    }

    fn picture(&mut self, _: &mut [u8]) -> Result<Duration, BoxError> {
        Ok(Duration::ZERO)
    }

    fn verdict(&mut self) -> Result<Verdict, BoxError> {
        Ok(Verdict::default())
    }
}

/// The error names the first pose that was left out, and why.
#[test]
fn balls_that_are_not_seen_and_poses_out_of_reach_are_told() {
    let arm = envs::carriers::KinovaGen3.arm().unwrap();
    let tip = Pose {
        position: HAND_START,
        rotation: arm.chain().tip(&arm.settings().ready).rotation,
    };
    let mut rig = Blank(RobotState {
        joints: arm.settings().ready.clone(),
        tip,
        closing: 0.0,
    });
    let high = Pose {
        position: HAND_START + 0.1 * DVec3::Z,
        ..tip
    };
    let trial = Trial::on_empty_table(0);
    for (poses, says) in [
        (vec![tip, high], "no ball of the colour"),
        (vec![high, tip], "cannot reach"),
    ] {
        let failed = calibrate(&mut rig, &arm, &SETTINGS, &poses, &trial);
        let error = failed.unwrap_err();
        assert!(matches!(
            error,
            CoversError::FewSightings {
                got: 0,
                pose: 1,
                ..
            }
        ));
        let message = error.to_string();
        assert!(
            message.contains("at least 10") && message.contains(says),
            "{message}"
        );
    }
}
