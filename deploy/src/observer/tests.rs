//! Comparison of close-ups on a rig with those of the simulation in which a policy was trained.

use std::sync::Arc;

use envs::{
    Camera, ControlSettings, Embodiment, ExtraViews, RGB_CHANNELS, Scene, SceneRenderer, TableTop,
    TaskGroup, TaskVariant,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use robots::Robot;
use symmetry::D2;

use crate::tests::pretrained;
use crate::{Deployment, FilmStrip, Rig, SimulatedRig, SimulatedRigSettings, Trial};

/// Trial of a button whose cap stands beside the hand's start.
const TRIAL: Trial = Trial {
    variant: TaskVariant { group: TaskGroup::BUTTON_PRESS, element: D2::FlipX },
    index: 1,
    seed: 1000,
};

/// Loads the pretrained policies, which were trained with close-ups.
fn deployment() -> Deployment {
    let deployment = pretrained("pretrained", None);
    assert_eq!(deployment.training_camera().extra_views, ExtraViews::CloseUp);
    deployment
}

/// Returns the pictures of training at the start of the trial: the whole picture and the close-up.
fn learnt(camera: Camera) -> [Vec<u8>; 2] {
    let TaskVariant { group, element } = TRIAL.variant;
    let scene = Arc::new(Scene::new(group, Embodiment::FLOATING_HAND, camera).unwrap());
    let mut rng = ChaCha8Rng::seed_from_u64(TRIAL.seed);
    rng.set_stream(TRIAL.index as u64);
    let placement = scene.sample_placement(&mut rng);
    let mut table = TableTop::new(Arc::clone(&scene), ControlSettings::default()).unwrap();
    table.reset_to(element, placement).unwrap();
    let mut seen = vec![0; camera.size * camera.size * RGB_CHANNELS];
    let mut renderer = SceneRenderer::new(scene).unwrap();
    renderer.render(&mut table, &mut seen).unwrap();
    parts(|image| renderer.compose_observation(&table, &seen, &[], image), camera)
}

/// Splits the image of an observation into its two pictures.
fn parts(compose: impl FnOnce(&mut [u8]), camera: Camera) -> [Vec<u8>; 2] {
    let mut image = vec![0; camera.size * camera.size * 2 * RGB_CHANNELS];
    compose(&mut image);
    [0, RGB_CHANNELS].map(|start| {
        let pixels = image.chunks(2 * RGB_CHANNELS).map(|pixel| &pixel[start..][..RGB_CHANNELS]);
        pixels.flatten().copied().collect()
    })
}

/// Returns the mean difference of two pictures (levels).
fn difference(a: &[u8], b: &[u8]) -> f64 {
    let differences = a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b)));
    differences.sum::<f64>() / a.len() as f64
}

#[test]
fn a_policy_on_the_robot_sees_the_close_ups_that_it_has_learnt_with() {
    let deployment = deployment();
    let camera = *deployment.training_camera();
    let mut rig =
        SimulatedRig::new(SimulatedRigSettings::NO_FAULTS, camera, Embodiment::KINOVA_GEN3)
            .unwrap();
    let arm = rig.arm().clone();
    let set_up = rig.set_up(&TRIAL).unwrap();
    let start = rig.state().unwrap();
    let mut observer = deployment.observer(&rig, &arm, &set_up, start).unwrap();
    observer.fetch_picture(&mut rig).unwrap();
    let mut seen = vec![0; camera.size * camera.size * RGB_CHANNELS];
    observer.write_picture_without_arm(&arm, &mut seen).unwrap();
    let seen = parts(|image| observer.compose_observation(&seen, &[], image), camera);
    for (on_robot, learnt) in seen.iter().zip(learnt(camera)) {
        let off = difference(on_robot, &learnt);
        for element in [D2::FlipX, D2::FlipY, D2::HalfTurn] {
            let mirrored = element.transform_image(&learnt, camera.size, camera.size, RGB_CHANNELS);
            let wrong = difference(on_robot, &mirrored);
            assert!(off < 4.0 && 2.0 * off < wrong, "{off} {wrong} {element}");
        }
    }
}

#[test]
fn a_trial_with_close_ups_is_filmed_as_any_other() {
    let mut deployment = deployment();
    let mut rig = SimulatedRig::new(
        SimulatedRigSettings::NO_FAULTS,
        *deployment.training_camera(),
        Embodiment::KINOVA_GEN3,
    )
    .unwrap();
    let arm = rig.arm().clone();
    let mut strip = FilmStrip::default();
    let played = deployment.run_trial(&mut rig, &arm, &TRIAL, Some(&mut strip));
    assert!(played.unwrap().refused_commands == 0);
    let picture = strip.to_picture();
    assert_eq!((picture.width, picture.height), (11 * 196 + 4, 3 * 148 + 4));
}
