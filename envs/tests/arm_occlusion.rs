//! Pictures in which the arm was painted out, as on a robot.

use envs::{
    ACTION_DIM, Camera, Embodiment, ExtraViews, ObservationsMut, RGB_CHANNELS, StepBuffers,
    TaskGroup, VecEnv, VecEnvSettings, ViewSettings, VisualDomainRandomisation,
};
use symmetry::D2;

const SIZE: usize = 64;
/// Less than half of an episode.
const STEPS: usize = 22;
/// Pixels by which the painted area may exceed the drawn arm: the mask's margin, and capsules
/// around shapes that they fit loosely.
const REACH: usize = 12;

fn settings(arm_occlusion: f64) -> VecEnvSettings {
    VecEnvSettings {
        num_envs: 1,
        threads: 1,
        embodiment: Embodiment::KINOVA_GEN3,
        camera: Camera { size: SIZE, arm_occlusion, ..Camera::default() },
        ..VecEnvSettings::default()
    }
}

fn begun(settings: VecEnvSettings, buffers: &mut StepBuffers) -> VecEnv {
    let mut env = VecEnv::new(settings, TaskGroup::PLATE_SLIDE, &[D2::Identity]).unwrap();
    env.reset(buffers.observations_mut()).unwrap();
    env
}

/// Plays the expert, and returns the images of each step.
fn play(env: &mut VecEnv, buffers: &mut StepBuffers) -> Vec<Vec<u8>> {
    let step = |_| {
        let mut actions = vec![0.0; env.settings().num_envs * ACTION_DIM];
        env.expert_actions(&mut actions).unwrap();
        env.step(&actions, buffers.step_results_mut()).unwrap();
        buffers.images.clone()
    };
    (0..STEPS).map(step).collect()
}

/// Returns for each pixel of the present state whether the camera sees the arm there.
fn drawn_arm(env: &mut VecEnv) -> Vec<bool> {
    let mut picture = |shows_arm| {
        let mut rgb = vec![0; SIZE * SIZE * RGB_CHANNELS];
        env.render(ViewSettings { from_corner: false, shows_arm, size: SIZE }, &mut rgb).unwrap();
        rgb
    };
    let (with, without) = (picture(true), picture(false));
    let pixels = with.chunks(RGB_CHANNELS).zip(without.chunks(RGB_CHANNELS));
    pixels.map(|(a, b)| a != b).collect()
}

/// Returns the current picture of the observation, each pixel by itself.
fn current(buffers: &StepBuffers) -> Vec<[u8; 3]> {
    let channels = buffers.images.len() / (SIZE * SIZE);
    buffers.images.chunks(channels).map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect()
}

/// Every pixel that shows the arm to a camera stays as it was before, and every other one that
/// differs from the picture without arm is near the arm.
#[test]
fn what_the_arm_hides_stays_as_it_was_last_seen() {
    let mark = Camera::default().mark.color;
    let [mut plain_buffers, mut buffers] =
        [0.0, 1.0].map(|occlusion| StepBuffers::new(&settings(occlusion)));
    let mut plain = begun(settings(0.0), &mut plain_buffers);
    let mut env = begun(settings(1.0), &mut buffers);
    assert_eq!(buffers.images, plain_buffers.images, "an episode begins without hidden objects");
    let (mut hidden, mut stale) = (0, 0);
    for _ in 0..STEPS {
        let before = current(&buffers);
        let mut action = [0.0; ACTION_DIM];
        env.expert_actions(&mut action).unwrap();
        env.step(&action, buffers.step_results_mut()).unwrap();
        plain.step(&action, plain_buffers.step_results_mut()).unwrap();
        assert_eq!(buffers.vectors, plain_buffers.vectors);
        let (arm, now, perfect) = (drawn_arm(&mut env), current(&buffers), current(&plain_buffers));
        let near = |pixel: usize| {
            let [row, column] = [pixel / SIZE, pixel % SIZE];
            let reach = |at: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(SIZE);
            reach(row).any(|row| reach(column).any(|column| arm[row * SIZE + column]))
        };
        for pixel in 0..SIZE * SIZE {
            let marked = [before[pixel], now[pixel]].contains(&mark);
            if arm[pixel] && !marked {
                assert_eq!(now[pixel], before[pixel], "pixel {pixel}");
                hidden += 1;
            }
            if now[pixel] != perfect[pixel] {
                assert!(near(pixel), "pixel {pixel} is far from the arm");
                stale += 1;
            }
        }
    }
    assert!(hidden > 1000, "the arm hides {hidden} pixels");
    assert!(stale > 20, "the puck moves under the arm: {stale} pixels");
}

#[test]
fn close_ups_show_what_the_arm_hides_as_it_was_last_seen() {
    let close_up = |occlusion| {
        let mut seen = settings(occlusion);
        seen.camera.extra_views = ExtraViews::CloseUp;
        let mut buffers = StepBuffers::new(&seen);
        let images = play(&mut begun(seen, &mut buffers), &mut buffers);
        images[STEPS - 1]
            .chunks(2 * RGB_CHANNELS)
            .map(|pixel| pixel[3..].to_vec())
            .collect::<Vec<_>>()
    };
    let differ = close_up(1.0).iter().zip(close_up(0.0)).filter(|(a, b)| **a != *b).count();
    assert!(differ > 20, "{differ} pixels of the close-up");
}

#[test]
fn a_restored_episode_remembers_what_is_hidden() {
    let mut buffers = StepBuffers::new(&settings(1.0));
    let mut env = begun(settings(1.0), &mut buffers);
    play(&mut env, &mut buffers);
    let snapshots = env.save().unwrap();
    let expected = play(&mut env, &mut buffers);
    let elsewhere = VecEnvSettings { seed: 5, ..settings(1.0) };
    let mut other = begun(elsewhere, &mut StepBuffers::new(&elsewhere));
    let (mut images, mut vectors) = (buffers.images.clone(), buffers.vectors.clone());
    let observations = ObservationsMut { images: &mut images, vectors: &mut vectors };
    other.restore(&snapshots, observations).unwrap();
    assert!(play(&mut other, &mut buffers) == expected);
}

#[test]
fn an_embodiment_without_servos_is_refused() {
    for embodiment in [Embodiment::SAWYER, Embodiment::FLOATING_HAND] {
        let refused = VecEnvSettings { embodiment, ..settings(1.0) }.check().unwrap_err();
        let message = refused.to_string();
        assert!(
            message.contains("`camera.arm_occlusion` is above 0")
                && message.contains(embodiment.name()),
            "{message}"
        );
    }
}

#[test]
fn another_group_begins_without_hidden_objects() {
    let first_images = |occlusion| {
        let mut seen = settings(occlusion);
        seen.camera.oversampling = 3;
        let mut buffers = StepBuffers::new(&seen);
        let mut env = begun(seen, &mut buffers);
        play(&mut env, &mut buffers);
        env.set_task_group(TaskGroup::DRAWER_CLOSE, &[D2::FlipX]).unwrap();
        env.reset(buffers.observations_mut()).unwrap();
        buffers.images
    };
    assert!(first_images(1.0) == first_images(0.0));
}

/// First pictures hide nothing, so they show that the errors of the camera are drawn alike.
#[test]
fn camera_errors_do_not_depend_on_what_is_hidden() {
    let first_images = |occlusion| {
        let randomisation = Some(VisualDomainRandomisation::NOMINAL);
        let seen = VecEnvSettings { num_envs: 4, randomisation, ..settings(occlusion) };
        let mut buffers = StepBuffers::new(&seen);
        let mut env = begun(seen, &mut buffers);
        let reset = |_| {
            env.reset(buffers.observations_mut()).unwrap();
            buffers.images.clone()
        };
        (0..3).map(reset).collect::<Vec<_>>()
    };
    let expected = first_images(0.0);
    assert!(first_images(0.5) == expected && first_images(1.0) == expected);
}

/// Other draws must not move: placements stay those of the same seed.
#[test]
fn a_share_of_the_episodes_is_hidden() {
    let images = |share| {
        let seen = VecEnvSettings { num_envs: 12, ..settings(share) };
        let mut buffers = StepBuffers::new(&seen);
        let mut env = begun(seen, &mut buffers);
        play(&mut env, &mut buffers).pop().unwrap()
    };
    let [perfect, half, hidden] = [0.0, 0.5, 1.0].map(images);
    let rows = |all: &[u8]| all.chunks(all.len() / 12).map(<[u8]>::to_vec).collect::<Vec<_>>();
    let (perfect, half, hidden) = (rows(&perfect), rows(&half), rows(&hidden));
    let kinds = half.iter().zip(perfect.iter().zip(&hidden));
    let kinds: Vec<[bool; 2]> = kinds.map(|(own, (a, b))| [own == a, own == b]).collect();
    assert!(kinds.iter().all(|[a, b]| a != b), "each is one or the other: {kinds:?}");
    let share = kinds.iter().filter(|[_, hides]| *hides).count();
    assert!((2..=10).contains(&share), "{share} of 12");
}
