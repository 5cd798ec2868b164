//! Foreign tasks: distinction of equal names, reserved names, and rejected values.

use std::sync::Arc;

use envs::{
    ACTION_DIM, Camera, ControlSettings, Embodiment, EnvError, Scene, StepBuffers, TableTop,
    TableTopSnapshot, TaskGroup, TaskSceneParts, VecEnv, VecEnvSettings,
};
use glam::DVec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

use crate::common::spoilt::Spoilt;
use crate::common::{self, PushBlock};

fn scene(group: TaskGroup) -> Result<Scene, EnvError> {
    Scene::new(group, Embodiment::FLOATING_HAND, Camera::default())
}

fn started(group: TaskGroup, control: ControlSettings) -> TableTop {
    let mut table = TableTop::new(Arc::new(scene(group).unwrap()), control).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    table.reset(D2::Identity, &mut rng).unwrap();
    table
}

/// Task with the name and the parts of [`PushBlock`], and another reward.
fn generous() -> TaskGroup {
    let spoilt = Spoilt { reward: |reward, _, _, _| reward.reward = 10.0, ..Spoilt::default() };
    spoilt.group()
}

fn with_scene(scene: String) -> TaskGroup {
    let task = PushBlock { scene, ..PushBlock::default() };
    TaskGroup::from_task(Box::leak(Box::new(task)))
}

#[test]
fn a_namesake_with_another_reward_is_refused_and_running_episodes_go_on() {
    let settings = VecEnvSettings {
        num_envs: 1,
        threads: 1,
        embodiment: Embodiment::FLOATING_HAND,
        ..VecEnvSettings::default()
    };
    let plain = Spoilt::default().group();
    let mut batch = StepBuffers::new(&settings);
    let mut env = VecEnv::new(settings, plain, &D2::ALL).unwrap();
    env.reset(batch.observations_mut()).unwrap();
    let objectless =
        PushBlock { name: "objectless".to_owned(), scene: "<mujocoinclude/>".to_owned() };
    let objectless = TaskGroup::from_task(Box::leak(Box::new(objectless)));
    let refused = [(generous(), "called `push-block` already"), (objectless, "MuJoCo cannot load")];
    for (task, says) in refused {
        let message = env.set_task_group(task, &D2::ALL).unwrap_err().to_string();
        assert!(message.contains(says), "{message}");
        env.step(&[0.0; ACTION_DIM], batch.step_results_mut()).unwrap();
    }
    env.set_task_group(plain, &D2::ALL).unwrap();
}

#[test]
fn a_snapshot_of_a_namesake_or_of_another_control_is_refused() {
    let plain = Spoilt::default().group();
    let short = ControlSettings { horizon: 100, ..ControlSettings::default() };
    let mut table = started(plain, ControlSettings::default());
    let before = table.save().unwrap();
    for (other, says) in [
        (started(generous(), ControlSettings::default()), "another task of that name"),
        (started(plain, short), "horizon: 100"),
    ] {
        let refused = table.restore(&other.save().unwrap()).unwrap_err();
        assert!(matches!(refused, EnvError::SceneMismatch { .. }), "{refused}");
        assert!(refused.to_string().contains(says), "{refused}");
        assert!(table.save().unwrap() == before);
    }
    table.restore(&started(plain, ControlSettings::default()).save().unwrap()).unwrap();
}

/// The loose cylinder's name is reserved in Meta-World's layout only.
#[test]
fn a_joint_called_decoy_is_the_tasks_own() {
    let group = with_scene(common::SCENE.replace("name=\"push\"", "name=\"decoy\""));
    let table = started(group, ControlSettings::default());
    let model = &table.scene().model;
    let address = model.joint_qpos_address(model.joint("decoy").unwrap());
    assert_eq!(table.simulation().qpos()[address], 0.0);
}

#[test]
fn a_goal_that_cannot_be_placed_is_refused() {
    let body = "<body name=\"goal\"><geom name=\"goal\" size=\"0.01\" contype=\"0\" \
                conaffinity=\"0\"/></body></worldbody>";
    let group = with_scene(common::SCENE.replace("</worldbody>", body));
    let message = scene(group).unwrap_err().to_string();
    assert!(message.contains("`goal`") && message.contains("mocap"), "{message}");
}

#[test]
fn parts_that_are_not_numbers_are_refused() {
    let offset = Spoilt { parts: |parts| parts.object_offset.y = f64::NAN, ..Spoilt::default() };
    let joint = Spoilt {
        parts: |parts| parts.start_joints = &[("push", f64::INFINITY)],
        ..Spoilt::default()
    };
    for (spoilt, says) in [(offset, "`object_offset` is [0, NaN, 0]"), (joint, "joint `push`")] {
        let error = scene(spoilt.group()).unwrap_err();
        assert!(matches!(error, EnvError::InvalidSetting { .. }), "{error}");
        assert!(error.to_string().contains(says), "{error}");
    }
}

#[test]
fn a_scene_that_changes_angles_or_physics_of_all_is_refused() {
    for element in ["<compiler angle=\"degree\"/>", "<option timestep=\"0.005\"/>"] {
        let part = format!("<mujocoinclude>{element}");
        let message =
            scene(with_scene(common::SCENE.replace("<mujocoinclude>", &part))).unwrap_err();
        assert!(message.to_string().contains("expected neither `<compiler`"), "{message}");
    }
}

#[test]
fn objects_that_cannot_be_placed_or_mirrored_are_refused() {
    let loose = |parts: &mut TaskSceneParts<'_>| parts.loose_joint = Some("push");
    let sliding = Spoilt { parts: loose, ..Spoilt::default() };
    let free = "<body name=\"free\"><freejoint name=\"push\"/><geom name=\"free\" \
                size=\"0.01\"/></body></worldbody>";
    let text = common::SCENE.replace("name=\"push\"", "name=\"slide\"");
    let task = PushBlock { scene: text.replace("</worldbody>", free), ..PushBlock::default() };
    let both = Spoilt { task, parts: loose, ..Spoilt::default() };
    let bare = |parts: &mut TaskSceneParts<'_>| {
        *parts = TaskSceneParts { handed: true, ..TaskSceneParts::default() }
    };
    let empty = Spoilt { parts: bare, ..Spoilt::default() };
    let ball = common::SCENE.replace(
        "type=\"slide\" axis=\"0 1 0\" range=\"-0.01 0.14\" limited=\"true\"",
        "type=\"ball\"",
    );
    let with_ball = || PushBlock { scene: ball.clone(), ..PushBlock::default() };
    let turning =
        Spoilt { task: with_ball(), parts: |parts| parts.handed = true, ..Spoilt::default() };
    let started_ball = Spoilt {
        task: with_ball(),
        parts: |parts| parts.start_joints = &[("push", 0.1)],
        ..Spoilt::default()
    };
    let far = Spoilt {
        parts: |parts| parts.hand_target = Some(DVec3::new(0.0, -0.4, 0.2)),
        ..Spoilt::default()
    };
    for (spoilt, says) in [
        (sliding, "setting `loose_joint` is `push` of type Slide, expected a free joint"),
        (both, "`push` beside a mocap body `object`, expected one of the two"),
        (empty, "setting `handed` is true, expected false, or a scene with"),
        (turning, "cannot be mirrored: it has a ball joint"),
        (started_ball, "setting `start_joints` is `push` of type Ball, expected slide joints and"),
        (far, "setting `hand_target` is [0, -0.4, 0.2], expected a place within"),
    ] {
        let message = scene(spoilt.group()).unwrap_err().to_string();
        assert!(message.contains(says), "{message}");
    }
}

#[test]
fn an_expert_that_asks_for_what_is_no_number_is_refused() {
    let lost = Spoilt { expert: |command, _| command.hand.x = f64::INFINITY, ..Spoilt::default() };
    let limp = Spoilt { expert: |command, _| command.finger = f64::NAN, ..Spoilt::default() };
    for (spoilt, says) in [(lost, "inf"), (limp, "the fingers to NaN")] {
        let table = started(spoilt.group(), ControlSettings::default());
        let message = table.expert_action().unwrap_err().to_string();
        assert!(message.contains("the expert of push-block"), "{message}");
        assert!(message.contains(says), "{message}");
    }
}

/// With the data of another model a reset and a restoration must fail half way.
#[test]
fn a_start_that_fails_leaves_no_episode_running() {
    type Start = fn(&mut TableTop, TableTopSnapshot) -> Result<(), EnvError>;
    let reset: Start = |table, _| {
        let placement = table.scene().sample_placement(&mut ChaCha8Rng::seed_from_u64(1));
        table.reset_to(D2::Identity, placement)
    };
    let restore: Start = |table, snapshot| table.restore(&snapshot);
    for start in [reset, restore] {
        let mut table = started(Spoilt::default().group(), ControlSettings::default());
        let snapshot = table.save().unwrap();
        let other = mujoco::Model::from_xml("<mujoco/>").unwrap();
        *table.simulation_mut() = mujoco::Data::new(Arc::new(other));
        start(&mut table, snapshot).unwrap_err();
        assert!(matches!(table.save(), Err(EnvError::NotReset)));
        assert!(matches!(table.step(&[0.0; ACTION_DIM]), Err(EnvError::NotReset)));
    }
}
