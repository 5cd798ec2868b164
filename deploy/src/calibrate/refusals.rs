//! Tests of errors: options that are rejected before the arm moves, and failures of a calibration.

use std::path::Path;
use std::time::Duration;

use clap::{Args, Parser};
use robots::Robot;

use super::command::CalibrateOptions;
use super::file::CameraCalibrationFile;
use super::mask::{MaskCheck, MaskComparison};
use super::mask_command::{CheckMaskOptions, mask_check_json};
use super::measure::{SkippedPose, calibrate_camera};
use super::tests::SETTINGS;
use crate::dry_rig::{DryRig, arm, dry_rig, untouched};
use crate::rig::{Rig, Trial};
use crate::{DeployError, DeployOptions};
use experiments::RunError;

/// Command line of these options alone.
#[derive(Parser)]
struct Line<O: Args> {
    #[command(flatten)]
    options: O,
}

fn parsed<O: Args>(arguments: &[&str]) -> Result<O, clap::Error> {
    let line = [&["covers"], arguments].concat();
    Line::try_parse_from(line).map(|line| line.options)
}

fn options(arguments: &[&str]) -> CalibrateOptions {
    parsed(arguments).unwrap()
}

/// Returns the error of a calibration with a spoilt rig.
fn spoilt(mut rig: DryRig) -> DeployError {
    let there = [rig.state().unwrap().tip];
    let trial = Trial::on_empty_table(0);
    calibrate_camera(&mut rig, &arm(), &SETTINGS, &there, &trial).unwrap_err()
}

#[test]
fn a_camera_whose_clock_is_ahead_calibrates_nothing() {
    let error = spoilt(dry_rig(|now| Ok(now + Duration::from_millis(5))));
    let message = error.to_string();
    assert!(matches!(error, DeployError::CameraClockAhead { .. }), "{message}");
}

/// Checks that a pose is skipped, and named, if the hand stays in its place but turns.
#[test]
fn a_hand_that_turns_does_not_stand() {
    let error = spoilt(DryRig { spin: 0.02, ..dry_rig(Ok) });
    let DeployError::TooFewSightings { skipped_pose: 1, reason, .. } = error else {
        panic!("{error}");
    };
    assert!(reason.contains("come to rest"), "{reason}");
}

#[test]
fn files_that_cannot_be_written_are_told_before_the_arm_moves() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut rig = untouched(Ok);
    for out in ["no/such/folder/c.json", "src"] {
        let out = root.join(out);
        let failed = options(&["--out", out.to_str().unwrap()]).run_on_rig(
            &mut rig,
            &arm(),
            &mut Vec::new(),
        );
        let error = failed.unwrap_err();
        assert!(matches!(error, DeployError::Run(RunError::Write { .. })), "{error}");
    }
    let mask = mask_options(&["--pictures", concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml/m")]);
    let error = mask.run_on_rig(&mut rig, &arm(), &mut Vec::new()).err().unwrap();
    assert!(matches!(error, DeployError::Run(RunError::Write { .. })), "{error}");
    let out = std::env::temp_dir().join(format!("covers-grey-{}.json", std::process::id()));
    let grey = options(&["--out", out.to_str().unwrap(), "--color", "120,110,100"]);
    let message = grey.run_on_rig(&mut rig, &arm(), &mut Vec::new()).unwrap_err().to_string();
    assert!(message.contains("far from grey"), "{message}");
    assert!(rig.now().is_zero());
}

/// Parses options of `covers check mask` with the policies of this repository.
fn mask_options(arguments: &[&str]) -> CheckMaskOptions {
    let run = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/pretrained-robot");
    parsed(&[&[run], arguments].concat()).unwrap()
}

#[test]
fn a_rig_of_your_own_takes_no_simulated_fault() {
    let (mut rig, arm, mut out) = (untouched(Ok), arm(), Vec::new());
    let fault = ["--fault", "position-error=30"];
    let calibration = options(&[&["--out", "no/such/c.json"], &fault[..]].concat());
    let refused = [
        calibration.run_on_rig(&mut rig, &arm, &mut out).err(),
        mask_options(&fault).run_on_rig(&mut rig, &arm, &mut out).err(),
    ];
    for error in refused {
        let message = error.unwrap().to_string();
        assert!(message.contains("position-error") && message.contains("simulated rigs alone"));
    }
    let robot = mask_options(&["--robot", "kinova-sim"]).run_on_rig(&mut rig, &arm, &mut out);
    let message = robot.err().unwrap().to_string();
    assert!(message.contains("`robot`") && message.contains("its own robot"), "{message}");
}

#[test]
fn options_that_would_be_ignored_are_refused() {
    for (arguments, says) in [
        (&["--fault", "mask-growth=50"][..], "makes no mask"),
        (&["--fault", "angle-error=1", "--fault", "angle-error=2"], "angle-error, twice"),
        (&["--color", "254.9,0.5,255"], "whole levels"),
    ] {
        let options = options(&[&["--out", "no/such/c.json"], arguments].concat());
        let message = options.run(&mut Vec::new()).unwrap_err().to_string();
        assert!(message.contains(says), "{message}");
    }
}

/// Checks that files of cameras that do not fit the rig are named, and settings out of range.
#[test]
fn what_does_not_fit_the_rig_is_named_before_the_arm_moves() {
    let folder = std::env::temp_dir().join(format!("covers-cameras-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let [json, yaml] = ["far.json", "camera.yaml"].map(|name| folder.join(name));
    let mut rig = untouched(Ok);
    let mut too_far = rig.calibration();
    too_far.extrinsics.translation.z = 99.9;
    CameraCalibrationFile::write(&too_far, &json).unwrap();
    let text = "image_width: 1280\nimage_height: 720\ncamera_matrix: [900, 0, 640, 0, 900, 360, 0, \
                0, 1]\ndistortion_coefficients: [0, 0, 0, 0]\n";
    std::fs::write(&yaml, text).unwrap();
    let [out, camera, far] =
        [folder.join("out.json"), yaml, json].map(|path| path.display().to_string());
    let mask = mask_options(&["--calibration", &far]);
    let calibrate = options(&["--out", &out, "--camera", &camera]);
    let inexact = options(&["--out", &out, "--arm-accuracy", "0"]);
    let errors = [
        mask.run_on_rig(&mut rig, &arm(), &mut Vec::new()).unwrap_err(),
        calibrate.run_on_rig(&mut rig, &arm(), &mut Vec::new()).unwrap_err(),
        inexact.run_on_rig(&mut rig, &arm(), &mut Vec::new()).unwrap_err(),
    ];
    std::fs::remove_dir_all(&folder).unwrap();
    let expected = [
        ["far.json", "99.9"],
        ["camera.yaml", "1280 x 720 pixels, but the rig's are 640 x 480"],
        ["accuracy of the arm", "--arm-accuracy"],
    ];
    for (error, words) in errors.iter().zip(expected) {
        assert!(words.iter().all(|word| error.to_string().contains(word)), "{error}");
    }
    assert!(rig.now().is_zero());
}

/// Parses options of `covers deploy` with policies that do not exist.
fn deploy_options(line: &str) -> Result<DeployOptions, clap::Error> {
    let words: Vec<&str> = line.split(' ').collect();
    parsed(&[&["no/such/run"], &words[..]].concat())
}

/// Returns the error of a command.
fn refusal(line: &str) -> String {
    deploy_options(line).unwrap().run(&mut Vec::new()).unwrap_err().to_string()
}

/// Checks sweeps of the calibration's errors, which a file replaces.
#[test]
fn a_sweep_of_what_a_file_replaces_is_refused() {
    for fault in ["position-error", "angle-error"] {
        let line = format!("--calibration c.json --out no/such/folder --sweep {fault}=0,1");
        let message = refusal(&line);
        assert!(message.contains(fault) && message.contains("--calibration"), "{message}");
    }
}

/// Checks that contradicting options are rejected before anything is read or written.
#[test]
fn sweeps_that_do_not_fit_are_refused() {
    let sweep = "--out no/such/folder --sweep mask-growth=0,10";
    for (rest, says) in
        [("--sweep mask-growth=5", "each fault once"), ("--sweep command-latency=0,20", "12.5")]
    {
        let message = refusal(&format!("{sweep} {rest}"));
        assert!(message.contains(says), "{message}");
    }
    for line in [
        "--sweep mask-growth=0,10",
        "--out no/such/folder --sweep-trials 3",
        "--dry-run --sweep mask-growth=0,10",
        "--dry-run --out no/such/folder --sweep mask-growth=0,10",
    ] {
        assert!(deploy_options(line).is_err(), "{line}");
    }
}

/// Checks that the JSON object says why a mask does not hold.
#[test]
fn a_mask_seen_in_too_few_poses_tells_what_was_left_out() {
    let check = MaskCheck {
        comparisons: vec![MaskComparison {
            pose_number: 1,
            iou: 0.7,
            uncovered_share: 0.0,
            excess_share: 0.3,
        }],
        skipped_poses: vec![SkippedPose { pose_number: 2, reason: "it is far".to_owned() }],
        ..MaskCheck::default()
    };
    let object = mask_check_json(&check);
    assert_eq!(object["holds"], false);
    assert_eq!(object["rows"].as_array().unwrap().len(), 1);
    assert_eq!(object["left_out"][0]["why"], "it is far");
}
