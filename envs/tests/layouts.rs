//! Properties of the layouts, and snapshots of other scenes.

use std::sync::Arc;

use envs::{
    Camera, Embodiment, Layout, Scene, StepBuffers, TableTop, TaskGroup, VecEnv, VecEnvSettings,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

use crate::common::PushBlock;

fn table(layout: Layout, group: TaskGroup) -> TableTop {
    let scene = Scene::new_in_layout(layout, group, Embodiment::FLOATING_HAND, Camera::default());
    TableTop::new(Arc::new(scene.unwrap()), layout.control_settings()).unwrap()
}

fn rng() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(0)
}

/// A door has its hinges on the left or on the right, and each is a model of its own.
#[test]
fn a_snapshot_brings_its_mirrored_objects_along() {
    let mut mirrored = table(Layout::Symmetric, TaskGroup::DOOR_OPEN);
    mirrored.reset(D2::FlipX, &mut rng()).unwrap();
    let play = |table: &mut TableTop| {
        for _ in 0..16 {
            let action = table.expert_action().unwrap();
            table.step(&action).unwrap();
        }
        table.task_state().unwrap()
    };
    play(&mut mirrored);
    let saved = mirrored.save().unwrap();
    let expected = play(&mut mirrored);
    let mut plain = table(Layout::Symmetric, TaskGroup::DOOR_OPEN);
    plain.reset(D2::Identity, &mut rng()).unwrap();
    plain.restore(&saved).unwrap();
    assert_eq!(play(&mut plain), expected);
    plain.reset(D2::Identity, &mut rng()).unwrap();
    play(&mut plain);
    let twin = play(&mut plain);
    assert!(twin.object.distance(expected.object) < 1e-12, "{twin:?} {expected:?}");
}

#[test]
fn a_task_without_metaworld_figures_has_no_metaworld_scene() {
    let group = TaskGroup::from_task(Box::leak(Box::new(PushBlock::default())));
    let (layout, arm) = (Layout::MetaWorld, Embodiment::SAWYER);
    let refused = Scene::new_in_layout(layout, group, arm, Camera::default());
    let message = refused.unwrap_err().to_string();
    assert!(message.contains("`metaworld` does not support push-block"), "{message}");
}

#[test]
fn a_vector_environment_runs_the_metaworld_layout_and_refuses_its_mirrored_variants() {
    let settings = VecEnvSettings {
        num_envs: 2,
        layout: Layout::MetaWorld,
        control: Layout::MetaWorld.control_settings(),
        ..VecEnvSettings::default()
    };
    let mut batch = StepBuffers::new(&settings);
    let mut env = VecEnv::new(settings, TaskGroup::BUTTON_PRESS, &[D2::Identity]).unwrap();
    env.reset(batch.observations_mut()).unwrap();
    // Meta-World starts the button's hand 0.2 m back
    assert!((batch.vectors[1] + 0.2).abs() < 0.01, "{:?}", batch.vectors);
    let refused = env.set_task_group(TaskGroup::BUTTON_PRESS, &D2::ALL);
    let message = refused.unwrap_err().to_string();
    assert!(message.contains("`metaworld` has no variant under flip x"), "{message}");
}

#[test]
fn a_vector_environment_runs_a_task_of_somebody_elses() {
    let settings = VecEnvSettings { num_envs: 4, ..VecEnvSettings::default() };
    let group = TaskGroup::from_task(Box::leak(Box::new(PushBlock::default())));
    let mut batch = StepBuffers::new(&settings);
    let mut env = VecEnv::new(settings, TaskGroup::GOAL_REACH, &D2::ALL).unwrap();
    env.prepare_task_groups(&TaskGroup::STANDARD).unwrap();
    env.set_task_group(group, &[D2::FlipY]).unwrap();
    assert!(env.reset(batch.observations_mut()).unwrap().is_empty());
    let green = |pixel: &[u8]| pixel[1] > 60 && pixel[0] < 60;
    let pixels = batch.images.chunks_exact(6).filter(|pixel| green(pixel));
    assert!(pixels.count() > 4 * 10, "the block shows");
}
