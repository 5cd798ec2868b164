//! Tests of trials on a rig without a simulation, whose camera may fail, and on the simulated one.

use std::path::Path;
use std::time::Duration;

use envs::{ControlSettings, Embodiment, Layout, TaskGroup, TaskVariant};
use glam::DVec3;
use inpainting::{CameraCalibration, Extrinsics};
use robots::Robot;
use symmetry::D2;

use super::controller::ActionController;
use super::deployment::{check_goal, check_training_conditions};
use super::dry_rig::{Camera, DryRig, arm, dry_rig, untouched};
use super::dry_run::DryRunRig;
use super::{
    DecisionStage, Deployment, MaskCheck, Rig, SimulatedRig, SimulatedRigSettings, Trial,
    UnsentCommand, VisionSettings, calibration_poses,
};
use crate::DeployError;
use experiments::{Experiment, RunFolder};
use learner::{LearnerSettings, OffPolicySettings};

const TRIAL: Trial = Trial {
    variant: TaskVariant { group: TaskGroup::GOAL_REACH, element: D2::FlipX },
    index: 1,
    seed: 1000,
};

fn deployment() -> Deployment {
    pretrained("pretrained-robot", None)
}

/// Loads policies of this repository, with a calibration in place of the rig's.
pub fn pretrained(name: &str, calibration: Option<CameraCalibration>) -> Deployment {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets").join(name);
    let vision = VisionSettings { calibration, ..VisionSettings::default() };
    Deployment::load(&RunFolder::from_path(&folder), vision).unwrap()
}

#[test]
fn goals_that_the_policy_lacks_or_does_not_see_are_refused() {
    let check = |group, goal| {
        let variant = TaskVariant { group, ..TRIAL.variant };
        check_goal(&Trial { variant, ..TRIAL }, goal)
    };
    let goal = Some(DVec3::new(0.1, 0.1, 0.2));
    check(TaskGroup::GOAL_REACH, goal).unwrap();
    check(TaskGroup::DRAWER_CLOSE, None).unwrap();
    let missing = check(TaskGroup::GOAL_REACH, None).unwrap_err();
    assert!(matches!(missing, DeployError::MissingGoal { .. }), "{missing}");
    let unseen = check(TaskGroup::DRAWER_CLOSE, goal).unwrap_err();
    assert!(matches!(unseen, DeployError::ImplausibleGoal { .. }), "{unseen}");
    let far = check(TaskGroup::GOAL_REACH, Some(DVec3::X)).unwrap_err();
    assert!(matches!(far, DeployError::ImplausibleGoal { .. }), "{far}");
}

/// Returns `true` if the hand moves in the next second.
fn moves(rig: &mut DryRig) -> bool {
    let place = |dry: &mut DryRig| dry.robot.robot().controller().tip_pose().position;
    let before = place(rig);
    rig.robot.robot_mut().advance(1.0).unwrap();
    place(rig).distance(before) > 1e-9
}

#[test]
fn a_robot_without_a_simulation_runs_a_trial_and_stands_at_its_end() {
    let mut rig = dry_rig(Ok);
    let score = deployment().run_trial(&mut rig, &arm(), &TRIAL, None).unwrap();
    assert!(!score.success);
    // 50 decisions at 8 Hz
    assert_eq!(rig.now(), Duration::from_millis(6250));
    let way = rig.state().unwrap().tip.position.distance(envs::HAND_TARGET_START);
    assert!(way > 0.02, "{way}");
    assert!(!moves(&mut rig));
}

/// An arm that stands still is told to move until it does: nothing counts as done that it refused.
#[test]
fn refused_commands_are_repeated() {
    let mut rig = DryRig { refusing: true, ..dry_rig(Ok) };
    let played = deployment().run_trial(&mut rig, &arm(), &TRIAL, None).unwrap();
    assert_eq!(played.refused_commands, 250);
    let speed = rig.last_command.unwrap().twist.linear.length();
    assert!(speed > 0.2, "{speed}");
}

#[test]
fn decisions_of_any_even_number_of_control_steps_are_possible() {
    for action_repeat in 1..=60 {
        let control = ControlSettings { action_repeat, ..ControlSettings::default() };
        let fits = ActionController::supports_decision_duration(&control);
        assert_eq!(fits, action_repeat % 2 == 0, "{action_repeat}");
    }
}

/// A hand in the frame of the base, say, or a goal in millimetres.
#[test]
fn a_rig_that_contradicts_the_arm_or_the_task_is_refused_before_a_command() {
    let mut rig = dry_rig(Ok);
    rig.shift = DVec3::new(0.0, 0.3, 0.0);
    let displaced = deployment().run_trial(&mut rig, &arm(), &TRIAL, None).unwrap_err().to_string();
    assert!(displaced.contains("300 mm and 0.0 degrees"), "{displaced}");
    assert_eq!(rig.now(), Duration::ZERO);
    let mut far = dry_rig(Ok);
    far.goal = DVec3::new(150.0, -100.0, 150.0);
    let unreached = deployment().run_trial(&mut far, &arm(), &TRIAL, None).unwrap_err().to_string();
    assert!(unreached.contains("the rig's goal is [150, -100, 150] m"), "{unreached}");
    let drawer =
        Trial { variant: TaskVariant { group: TaskGroup::DRAWER_CLOSE, ..TRIAL.variant }, ..TRIAL };
    let unasked = deployment().run_trial(&mut dry_rig(Ok), &arm(), &drawer, None).unwrap_err();
    assert!(unasked.to_string().contains("do not observe one"), "{unasked}");
}

/// A blue table, in a trial and in a check of the mask; the known one behind a poor camera is none.
#[test]
fn a_table_that_the_policy_does_not_know_is_refused_before_a_command() {
    let mut blue = DryRig { table: [40, 60, 150], ..dry_rig(Ok) };
    let (mut deployment, first) = (deployment(), &calibration_poses(&arm())[..1]);
    for refused in [
        MaskCheck::run_on_rig(&deployment, &mut blue, &arm(), first, &TRIAL).map(|_| ()),
        deployment.run_trial(&mut blue, &arm(), &TRIAL, None).map(|_| ()),
    ] {
        let error = refused.unwrap_err();
        assert!(matches!(error, DeployError::UnknownTable { part: "tint", .. }), "{error}");
    }
    assert_eq!((blue.now(), blue.last_command), (Duration::ZERO, None));
    let mut poor = SimulatedRigSettings::NOMINAL_FAULTS;
    poor.camera_imperfections.position_error = 0.03;
    poor.camera_imperfections.angle_error = 3_f64.to_radians();
    poor.camera_imperfections.exposure_drift_sd = 0.4;
    let camera = *deployment.training_camera();
    let mut rig = SimulatedRig::new(poor, camera, Embodiment::KINOVA_GEN3).unwrap();
    let arm = rig.arm().clone();
    for group in TaskGroup::STANDARD {
        for (index, &variant) in group.variants().iter().enumerate() {
            let set_up = rig.set_up(&Trial { variant, index, ..TRIAL }).unwrap();
            let start = rig.state().unwrap();
            deployment.observer(&rig, &arm, &set_up, start).map(|_| ()).unwrap();
        }
    }
}

#[test]
fn a_camera_that_fails_or_stops_stops_the_arm() {
    let fails: Camera = |now| {
        if now < Duration::from_millis(700) { Ok(now) } else { Err("the cable is loose".into()) }
    };
    let freezes: Camera = |now| Ok(now.min(Duration::from_millis(300)));
    let ahead: Camera = |now| Ok(now + Duration::from_millis(2));
    for (camera, says) in
        [(fails, "the cable is loose"), (freezes, "ms old"), (ahead, "2 ms in the future")]
    {
        let mut rig = dry_rig(camera);
        let failed = deployment().run_trial(&mut rig, &arm(), &TRIAL, None);
        let message = failed.unwrap_err().to_string();
        assert!(message.contains(says), "{message}");
        assert!(rig.now() < Duration::from_secs(1) && !moves(&mut rig));
    }
}

/// Checks that a dry run completes, respects the arm's limits and sends nothing to the robot, not
/// even after an error.
#[test]
fn a_dry_run_sends_nothing_to_the_robot() {
    let mut rig = untouched(Ok);
    let before = rig.state().unwrap();
    let mut deployment = deployment();
    let report = deployment.dry_run(&mut rig, &arm(), &TRIAL).unwrap();
    assert_eq!(rig.state().unwrap(), before);
    assert_eq!((report.actions.len(), report.unsent_commands.len()), (50, 250));
    let limits = arm().settings().control.limits;
    let mut last = robots::Twist::ZERO;
    for UnsentCommand { command, resulting_twist, refusal } in &report.unsent_commands {
        assert!(refusal.is_none() && command.check().is_ok());
        assert!(command.twist.linear.length() <= limits.max_speed + 1e-12);
        let sudden = (resulting_twist.linear - last.linear).length() / 0.025;
        assert!(sudden <= limits.max_acceleration + 1e-9, "{sudden}");
        last = *resulting_twist;
    }
    assert!(report.unsent_commands.iter().any(|one| one.resulting_twist.linear.length() > 0.05));
    let text = report.text();
    assert!(text.contains("decision  49") && text.contains("250 commands were withheld, 0"));
    for (stage, count) in DecisionStage::ALL.into_iter().zip([51, 51, 1, 50, 50]) {
        assert_eq!(report.latencies.measurement_count(stage), count, "{}", stage.name());
        assert!(text.contains(stage.name()), "{text}");
    }
    let broken: Camera = |_| Err("the cable is loose".into());
    let failed = deployment.dry_run(&mut untouched(broken), &arm(), &TRIAL);
    assert!(failed.unwrap_err().to_string().contains("the cable is loose"));
}

/// Checks that nothing is sent to the robot with a calibration of another camera, neither in a
/// trial nor by a check of the mask.
#[test]
fn calibrations_of_other_cameras_are_refused_before_the_arm_moves() {
    let mut rig = untouched(Ok);
    let mut millimetres = rig.calibration();
    millimetres.intrinsics.focal_lengths = [1.93; 2];
    let mut deployment = pretrained("pretrained-robot", Some(millimetres));
    let first = &calibration_poses(&arm())[..1];
    for refused in [
        MaskCheck::run_on_rig(&deployment, &mut rig, &arm(), first, &TRIAL).map(|_| ()),
        deployment.run_trial(&mut rig, &arm(), &TRIAL, None).map(|_| ()),
        deployment.dry_run(&mut rig, &arm(), &TRIAL).map(|_| ()),
    ] {
        let error = refused.unwrap_err();
        assert!(matches!(error, DeployError::ImplausibleCalibration { .. }), "{error}");
        assert!(error.to_string().contains("1.93"), "{error}");
    }
}

/// Checks that a file is compared with the standing calibration, not with that of a trial, which
/// has errors of its own.
#[test]
fn calibrations_are_held_to_the_same_camera_in_every_trial() {
    let mut settings = SimulatedRigSettings::NO_FAULTS;
    settings.camera_imperfections.position_error = 0.08;
    let camera = *deployment().training_camera();
    let mut rig = SimulatedRig::new(settings, camera, Embodiment::KINOVA_GEN3).unwrap();
    let (arm, truth) = (rig.arm().clone(), rig.true_calibration());
    rig.set_up(&TRIAL).unwrap();
    let misjudged = rig.calibration().camera_position() - truth.camera_position();
    assert!((misjudged.length() - 0.08).abs() < 1e-9, "{misjudged}");
    // 18 cm from what the first trial takes the camera for
    let position = truth.camera_position() - 0.1 * misjudged.normalize();
    let rotation = truth.extrinsics.rotation;
    let file = CameraCalibration {
        extrinsics: Extrinsics { rotation, translation: -(rotation * position) },
        ..truth
    };
    let mut other_rig = SimulatedRig::new(settings, camera, Embodiment::KINOVA_GEN3).unwrap();
    let mut deployment = pretrained("pretrained-robot", Some(file));
    for index in [1, 2] {
        let trial = Trial { index, ..TRIAL };
        deployment.run_trial(&mut other_rig, &arm, &trial, None).unwrap();
    }
    MaskCheck::run_on_rig(&deployment, &mut other_rig, &arm, &calibration_poses(&arm)[..1], &TRIAL)
        .unwrap();
}

/// Checks that the background of a dry run must be a recent picture.
#[test]
fn a_dry_run_takes_no_old_background() {
    let ahead: Camera = |now| Ok(now + Duration::from_millis(2));
    for (camera, says) in
        [((|_| Ok(Duration::ZERO)) as Camera, "1000 ms old"), (ahead, "2 ms in the future")]
    {
        let mut rig = dry_rig(camera);
        rig.wait(Duration::from_secs(1)).unwrap();
        let set_up = DryRunRig::new(&mut rig, &arm()).unwrap().set_up(&TRIAL);
        let message = set_up.unwrap_err().to_string();
        assert!(message.contains(says), "{message}");
    }
}

#[test]
fn a_dry_run_without_a_table_is_refused() {
    let mut deployment = deployment();
    let camera = *deployment.training_camera();
    let mut rig =
        SimulatedRig::new(SimulatedRigSettings::NO_FAULTS, camera, Embodiment::KINOVA_GEN3)
            .unwrap();
    let arm = rig.arm().clone();
    let failed = deployment.dry_run(&mut rig, &arm, &TRIAL);
    assert!(matches!(failed, Err(DeployError::Rig { .. })));
}

/// Checks a policy on a camera with all faults.
#[test]
fn the_simulated_rig_reaches_a_goal_under_nominal_faults() {
    let mut deployment = deployment();
    let camera = *deployment.training_camera();
    let mut rig =
        SimulatedRig::new(SimulatedRigSettings::NOMINAL_FAULTS, camera, Embodiment::KINOVA_GEN3)
            .unwrap();
    assert!(rig.state().is_err(), "no table is set");
    let arm = rig.arm().clone();
    let mut strip = super::FilmStrip::default();
    let score = deployment.run_trial(&mut rig, &arm, &TRIAL, Some(&mut strip)).unwrap();
    assert!(score.success && score.policy_fits && score.refused_commands == 0, "{score:?}");
    // decisions 0, 5, ... 50
    let picture = strip.to_picture();
    assert_eq!((picture.width, picture.height), (11 * 196 + 4, 3 * 148 + 4));
    let again = deployment.run_trial(&mut rig, &arm, &TRIAL, None).unwrap();
    assert_eq!(again.policy, score.policy);
}

#[test]
fn policies_that_would_act_otherwise_are_refused() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/pretrained-robot");
    let learnt = RunFolder::from_path(&folder).read_experiment().unwrap();
    type Spoil = fn(&mut Experiment);
    let cases: [(&str, Spoil); 4] = [
        ("envs.layout", |e| e.envs.layout = Layout::MetaWorld),
        ("envs.camera.misalignment", |e| e.envs.camera.misalignment.tilt_degrees = [0.0, 1.0]),
        ("action_repeat", |e| e.envs.control.action_repeat = 5),
        ("context", |e| {
            e.learner = LearnerSettings::OffPolicy(OffPolicySettings::three_rl_baseline());
        }),
    ];
    check_training_conditions(&learnt.learner, &learnt.envs).unwrap();
    for (name, spoil) in cases {
        let mut spoilt = learnt.clone();
        spoil(&mut spoilt);
        let refusal = check_training_conditions(&spoilt.learner, &spoilt.envs).unwrap_err();
        assert!(refusal.to_string().contains(name), "{refusal}");
    }
}
