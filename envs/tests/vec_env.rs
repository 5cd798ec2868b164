//! Vector environment: independence of the number of threads, ends of episodes, and errors.

use std::ops::Range;
use std::sync::Arc;

use envs::{
    ACTION_DIM, Camera, ControlSettings, Embodiment, EnvError, ExtraViews, ObservationsMut,
    RGB_CHANNELS, STATE_DETAILS_DIM, Scene, SceneRenderer, StepBuffers, TableTop, TaskGroup,
    VECTOR_OBSERVATION_DIM, VecEnv, VecEnvSettings, VisualDomainRandomisation,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

const N: usize = 3;

fn settings(threads: usize) -> VecEnvSettings {
    let mut settings =
        VecEnvSettings { num_envs: N, threads, seed: 11, ..VecEnvSettings::default() };
    settings.camera.size = 16;
    settings.control.horizon = 60;
    settings
}

fn action(step: usize) -> Vec<f32> {
    (0..N * ACTION_DIM).map(|i| ((i * 7 + step * 3) % 5) as f32 / 2.0 - 1.0).collect()
}

/// Returns everything that 15 steps over a switch of groups observe, as one list of numbers.
fn trace(threads: usize, embodiment: Embodiment) -> Vec<u32> {
    let settings = VecEnvSettings { embodiment, ..settings(threads) };
    let mut env = VecEnv::new(settings, TaskGroup::DRAWER_CLOSE, &D2::ALL).unwrap();
    let mut buffers = StepBuffers::new(&settings);
    let mut trace = Vec::new();
    for group in [TaskGroup::DRAWER_CLOSE, TaskGroup::PLATE_SLIDE, TaskGroup::DRAWER_CLOSE] {
        env.set_task_group(group, &D2::ALL).unwrap();
        env.reset(buffers.observations_mut()).unwrap();
        for step in 0..7 {
            env.step(&action(step), buffers.step_results_mut()).unwrap();
            trace.extend(buffers.images.iter().map(|&v| u32::from(v)));
            trace.extend(buffers.vectors.iter().map(|v| v.to_bits()));
            trace.extend(buffers.rewards.iter().map(|v| v.to_bits()));
            trace.extend(buffers.final_vectors.iter().map(|v| v.to_bits()));
            trace.extend(buffers.final_images.iter().map(|&v| u32::from(v)));
            trace.extend(buffers.success.iter().map(|&v| u32::from(v)));
            trace.extend(buffers.success_at_end.iter().map(|&v| u32::from(v)));
            trace.extend(buffers.truncated.iter().map(|&v| u32::from(v)));
        }
    }
    trace
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    for embodiment in [Embodiment::SAWYER, Embodiment::KINOVA_GEN3] {
        let one = trace(1, embodiment);
        for threads in [2, 3, 8] {
            assert!(trace(threads, embodiment) == one, "{embodiment} on {threads} threads");
        }
    }
}

/// Each share must write the rows that all environments together write there, and no others.
#[test]
fn shares_are_parts_of_the_whole_and_may_be_empty() {
    let settings = settings(2);
    let run = |share: Range<usize>| {
        let mut env =
            VecEnv::new_shard(settings, TaskGroup::PLATE_SLIDE, &D2::ALL, share.clone()).unwrap();
        let mut buffers = StepBuffers::new(&settings);
        assert!(env.reset(buffers.observations_mut()).unwrap().is_empty());
        assert!(env.step(&action(0), buffers.step_results_mut()).unwrap().is_empty());
        let rows = |values: &[f32]| values.chunks(values.len() / N).map(<[f32]>::to_vec).collect();
        let vectors: Vec<Vec<f32>> = rows(&buffers.vectors);
        (
            vectors,
            buffers.images.chunks(settings.image_len()).map(<[u8]>::to_vec).collect::<Vec<_>>(),
        )
    };
    let whole = run(0..N);
    for share in [0..0, N..N, 0..1, 1..N] {
        let (vectors, images) = run(share.clone());
        for env in 0..N {
            let is_own = share.contains(&env);
            assert_eq!(vectors[env] == whole.0[env], is_own, "{share:?}, {env}");
            assert_eq!(images[env] == whole.1[env], is_own, "{share:?}, {env}");
            assert!(is_own || images[env].iter().all(|&byte| byte == 0), "{share:?}, {env}");
        }
    }
}

#[test]
fn shares_of_other_environments_are_refused() {
    let [high, low] = [2, 1];
    for (share, shown) in [(high..low, "2..1"), (1..N + 1, "1..4"), (N + 1..N + 1, "4..4")] {
        let env = VecEnv::new_shard(settings(1), TaskGroup::PLATE_SLIDE, &D2::ALL, share);
        let message = env.err().unwrap().to_string();
        assert!(message.contains(&format!("`share` is {shown}, expected a range")), "{message}");
    }
}

#[test]
fn the_end_of_an_episode_returns_both_the_final_and_the_first_observation() {
    let settings = settings(2);
    let mut env = VecEnv::new(settings, TaskGroup::GOAL_REACH, &D2::ALL).unwrap();
    let mut buffers = StepBuffers::new(&settings);
    env.reset(buffers.observations_mut()).unwrap();
    let start = buffers.vectors.clone();
    for step in 1..=settings.control.decisions_per_episode() {
        assert!(buffers.truncated.iter().all(|&end| !end), "before step {step}");
        env.step(&[1.0; N * ACTION_DIM], buffers.step_results_mut()).unwrap();
    }
    assert!(buffers.truncated.iter().all(|&end| end));
    for index in 0..N {
        let row = index * VECTOR_OBSERVATION_DIM..index * VECTOR_OBSERVATION_DIM + 3;
        assert_eq!(
            buffers.vectors[row.clone()],
            start[row.clone()],
            "a new episode starts at rest"
        );
        let moved = buffers.final_vectors[row.start] - start[row.start];
        assert!(moved > 0.1, "environment {index} moved {moved} m in its episode");
    }
    // the second half of the channels is the episode's first picture, which is also the current one
    // now
    for pixel in buffers.images.chunks_exact(6) {
        assert_eq!(pixel[..3], pixel[3..]);
    }
    assert!(buffers.final_images.chunks_exact(6).any(|pixel| pixel[..3] != pixel[3..]));
}

/// One environment without workers: the slow reference of a row.
struct Twin {
    table: TableTop,
    renderer: SceneRenderer,
    /// Second renderer of the table, without the mark and as large as close-ups show it.
    large: (TableTop, SceneRenderer),
    rng: ChaCha8Rng,
    first: Vec<u8>,
}

impl Twin {
    fn new(settings: &VecEnvSettings, group: TaskGroup, env: usize) -> Self {
        let scene = Scene::new(group, settings.embodiment, settings.camera).unwrap();
        let scene = Arc::new(scene);
        let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
        rng.set_stream(env as u64);
        Self {
            table: TableTop::new(Arc::clone(&scene), settings.control).unwrap(),
            large: large(settings, group),
            renderer: SceneRenderer::new(scene).unwrap(),
            rng,
            first: vec![0; settings.camera.size * settings.camera.size * RGB_CHANNELS],
        }
    }

    fn begin(&mut self) -> (Vec<u8>, Vec<f32>) {
        let element = D2::ALL[self.rng.random_range(0..4)];
        self.large.0.reset(element, &mut self.rng.clone()).unwrap();
        self.table.reset(element, &mut self.rng).unwrap();
        self.renderer.render(&mut self.table, &mut self.first).unwrap();
        self.observe()
    }

    fn observe(&mut self) -> (Vec<u8>, Vec<f32>) {
        let mut now = self.first.clone();
        self.renderer.render(&mut self.table, &mut now).unwrap();
        let mut pictures = vec![now];
        match self.table.scene().camera.extra_views {
            ExtraViews::First => pictures.push(self.first.clone()),
            ExtraViews::CloseUp => pictures.push(self.close_up()),
            ExtraViews::FirstAndCloseUp => pictures.extend([self.first.clone(), self.close_up()]),
        }
        let pixel = |index| {
            let pixels = pictures.iter().map(move |picture| &picture[index..][..RGB_CHANNELS]);
            pixels.flatten().copied()
        };
        let image = (0..self.first.len()).step_by(RGB_CHANNELS).flat_map(pixel);
        (image.collect(), self.table.observe().unwrap().to_vec())
    }

    /// Returns the pixels around the hand's place on the table, one by one.
    fn close_up(&mut self) -> Vec<u8> {
        let camera = self.table.scene().camera;
        let side = camera.size * camera.oversampling;
        let mut large = vec![0; side * side * RGB_CHANNELS];
        let (table, renderer) = &mut self.large;
        renderer.render(table, &mut large).unwrap();
        let hand = self.table.hand_position();
        let per_metre = side as f64 / (2.0 * camera.half_extent);
        let middle = [-hand.y, hand.x].map(|way| (way * per_metre).round());
        let half = [side, camera.size].map(|side| side as f64 / 2.0);
        let pixel = |index: usize| {
            let place = [index / camera.size, index % camera.size];
            let [row, column] =
                [0, 1].map(|axis| half[0] + middle[axis] + place[axis] as f64 - half[1]);
            let inside = |coordinate: f64| (0.0..side as f64).contains(&coordinate);
            if inside(row) && inside(column) {
                large[(row as usize * side + column as usize) * RGB_CHANNELS..][..RGB_CHANNELS]
                    .to_vec()
            } else {
                vec![128; RGB_CHANNELS]
            }
        };
        (0..camera.size * camera.size).flat_map(pixel).collect()
    }
}

/// Table, and a camera that draws it as large as close-ups show it.
fn large(settings: &VecEnvSettings, group: TaskGroup) -> (TableTop, SceneRenderer) {
    let camera = settings.camera;
    let large = camera.with_size(camera.size * camera.oversampling);
    let scene = Arc::new(Scene::new(group, settings.embodiment, large).unwrap());
    let table = TableTop::new(Arc::clone(&scene), settings.control).unwrap();
    (table, SceneRenderer::without_arm(scene).unwrap())
}

fn row(observations: &ObservationsMut, env: usize) -> (Vec<u8>, Vec<f32>) {
    let image = observations.images.len() / N;
    (
        observations.images[env * image..][..image].to_vec(),
        observations.vectors[env * VECTOR_OBSERVATION_DIM..][..VECTOR_OBSERVATION_DIM].to_vec(),
    )
}

#[test]
fn every_row_is_what_one_environment_driven_by_hand_shows() {
    for beside in [ExtraViews::First, ExtraViews::CloseUp, ExtraViews::FirstAndCloseUp] {
        for oversampling in [1, 3] {
            let mut settings = settings(2);
            (settings.camera.oversampling, settings.camera.extra_views) = (oversampling, beside);
            rows_equal_environments_driven_by_hand(settings);
        }
    }
}

fn rows_equal_environments_driven_by_hand(settings: VecEnvSettings) {
    let group = TaskGroup::BUTTON_PRESS;
    let mut env = VecEnv::new(settings, group, &D2::ALL).unwrap();
    let mut buffers = StepBuffers::new(&settings);
    let mut twins = [0, 1, 2].map(|index| Twin::new(&settings, group, index));
    env.reset(buffers.observations_mut()).unwrap();
    for (index, twin) in twins.iter_mut().enumerate() {
        assert_eq!(row(&buffers.observations_mut(), index), twin.begin());
    }
    for step in 0..14 {
        let actions = action(step);
        env.step(&actions, buffers.step_results_mut()).unwrap();
        for (index, twin) in twins.iter_mut().enumerate() {
            let action = actions[index * ACTION_DIM..][..ACTION_DIM].try_into().unwrap();
            let expected = twin.table.step(action).unwrap();
            twin.large.0.step(action).unwrap();
            assert_eq!(buffers.rewards[index], expected.reward as f32);
            assert_eq!(buffers.success[index], expected.success);
            assert_eq!(buffers.success_at_end[index], expected.success_at_end);
            assert_eq!(buffers.truncated[index], expected.truncated);
            let mut observation = twin.observe();
            if expected.truncated {
                let last = buffers.step_results_mut().final_observations;
                assert_eq!(row(&last, index), observation, "environment {index}");
                observation = twin.begin();
            }
            let now = row(&buffers.observations_mut(), index);
            assert_eq!(now, observation, "environment {index} after step {step}");
        }
    }
}

#[test]
fn success_at_any_step_and_at_the_end_are_told_apart() {
    let settings = VecEnvSettings { control: ControlSettings::default(), ..settings(2) };
    let group = TaskGroup::GOAL_REACH;
    let mut env = VecEnv::new(settings, group, &D2::ALL).unwrap();
    let mut batch = StepBuffers::new(&settings);
    let mut twins = [0, 1, 2].map(|index| Twin::new(&settings, group, index));
    env.reset(batch.observations_mut()).unwrap();
    twins.iter_mut().for_each(|twin| drop(twin.begin()));
    let mut apart = 0;
    for decision in 0..settings.control.decisions_per_episode() {
        let action = |twin: &Twin| match decision {
            0..30 => twin.table.expert_action().unwrap(),
            _ => [0.6, -0.6, 0.6, 0.0],
        };
        let actions = twins.each_ref().map(action);
        env.step(actions.as_flattened(), batch.step_results_mut()).unwrap();
        let expected = [0, 1, 2].map(|i| twins[i].table.step(&actions[i]).unwrap());
        assert_eq!(batch.success, expected.map(|step| step.success));
        assert_eq!(batch.success_at_end, expected.map(|step| step.success_at_end));
        apart += usize::from(batch.success != batch.success_at_end);
    }
    assert!(apart > 0);
}

#[test]
fn a_seed_given_later_is_as_good_as_one_given_at_first() {
    let first = |env: &mut VecEnv, buffers: &mut StepBuffers| {
        env.reset(buffers.observations_mut()).unwrap();
        (buffers.images.clone(), buffers.vectors.clone())
    };
    let settings = settings(2);
    let mut buffers = StepBuffers::new(&settings);
    let mut env = VecEnv::new(settings, TaskGroup::GOAL_REACH, &D2::ALL).unwrap();
    let fresh = first(&mut env, &mut buffers);
    let second = first(&mut env, &mut buffers);
    env.reseed(settings.seed + 1).unwrap();
    let other = first(&mut env, &mut buffers);
    env.reseed(settings.seed).unwrap();
    assert_eq!(first(&mut env, &mut buffers), fresh);
    assert!(fresh != second && fresh != other);
}

#[test]
fn settings_travel_as_json_and_unknown_ones_are_refused() {
    let text = serde_json::to_string(&settings(2)).unwrap();
    assert!(text.contains(r#""layout":"symmetric","embodiment":"sawyer""#), "{text}");
    assert_eq!(serde_json::from_str::<VecEnvSettings>(&text).unwrap(), settings(2));
    let wrong = text.replace("num_envs", "number_of_envs");
    let message = serde_json::from_str::<VecEnvSettings>(&wrong).unwrap_err();
    assert!(message.to_string().contains("number_of_envs"), "{message}");
}

#[test]
fn variants_are_drawn_from_the_elements_given() {
    let settings = VecEnvSettings { num_envs: 12, ..settings(2) };
    let mut env = VecEnv::new(settings, TaskGroup::GOAL_REACH, &[D2::FlipX]).unwrap();
    let mut buffers = StepBuffers::new(&settings);
    env.reset(buffers.observations_mut()).unwrap();
    let goals = |batch: &StepBuffers| -> Vec<(bool, bool)> {
        let rows = batch.vectors.chunks_exact(VECTOR_OBSERVATION_DIM);
        rows.map(|row| (row[4] < 0.0, row[5] < 0.0)).collect()
    };
    assert!(goals(&buffers).iter().all(|&quadrant| quadrant == (true, false)));
    env.set_task_group(TaskGroup::GOAL_REACH, &D2::ALL).unwrap();
    env.reset(buffers.observations_mut()).unwrap();
    let quadrants: std::collections::HashSet<_> = goals(&buffers).into_iter().collect();
    assert!(quadrants.len() > 1);
}

#[test]
fn bad_input_is_refused_and_changes_nothing() {
    let settings = settings(2);
    let mut env = VecEnv::new(settings, TaskGroup::GOAL_REACH, &D2::ALL).unwrap();
    let mut buffers = StepBuffers::new(&settings);
    let early = env.step(&action(0), buffers.step_results_mut()).unwrap_err();
    assert!(early.to_string().contains("no episode is running"), "{early}");
    env.reset(buffers.observations_mut()).unwrap();
    let short = env.step(&[0.0; 3], buffers.step_results_mut()).unwrap_err();
    assert!(short.to_string().contains("`actions` has 3 elements, expected 12"));
    let mut bad = action(0);
    bad[6] = f32::INFINITY;
    let message = env.step(&bad, buffers.step_results_mut()).unwrap_err().to_string();
    assert!(message.contains("environment 1: component 2 of the action is inf"), "{message}");
    let none = env.set_task_group(TaskGroup::GOAL_REACH, &[]).unwrap_err();
    assert!(none.to_string().contains("no variants of goal-reach"));
    env.step(&action(0), buffers.step_results_mut()).unwrap();
    let mut fresh = VecEnv::new(settings, TaskGroup::GOAL_REACH, &D2::ALL).unwrap();
    let mut expected = StepBuffers::new(&settings);
    fresh.reset(expected.observations_mut()).unwrap();
    fresh.step(&action(0), expected.step_results_mut()).unwrap();
    assert_eq!(buffers.vectors, expected.vectors);
    assert_eq!(buffers.images, expected.images);
}

#[test]
fn a_switch_ends_running_episodes() {
    let settings = settings(2);
    let mut env = VecEnv::new(settings, TaskGroup::DRAWER_CLOSE, &[D2::Identity]).unwrap();
    let mut buffers = StepBuffers::new(&settings);
    env.reset(buffers.observations_mut()).unwrap();
    env.set_task_group(TaskGroup::GOAL_REACH, &D2::ALL).unwrap();
    env.reset(buffers.observations_mut()).unwrap();
    env.set_task_group(TaskGroup::DRAWER_CLOSE, &[D2::HalfTurn]).unwrap();
    let stale = env.step(&action(0), buffers.step_results_mut()).unwrap_err();
    assert!(stale.to_string().contains("no episode is running"), "{stale}");
    env.reset(buffers.observations_mut()).unwrap();
    env.step(&action(0), buffers.step_results_mut()).unwrap();
}

#[test]
fn preparing_groups_changes_nothing_that_is_seen() {
    let settings = settings(2);
    let mut plain = VecEnv::new(settings, TaskGroup::GOAL_REACH, &D2::ALL).unwrap();
    let mut prepared = VecEnv::new(settings, TaskGroup::GOAL_REACH, &D2::ALL).unwrap();
    let mut buffers = [StepBuffers::new(&settings), StepBuffers::new(&settings)];
    let [a, b] = &mut buffers;
    for group in [TaskGroup::GOAL_REACH, TaskGroup::PLATE_SLIDE] {
        plain.set_task_group(group, &D2::ALL).unwrap();
        prepared.set_task_group(group, &D2::ALL).unwrap();
        plain.reset(a.observations_mut()).unwrap();
        prepared.reset(b.observations_mut()).unwrap();
        plain.step(&action(0), a.step_results_mut()).unwrap();
        // in the middle of episodes
        prepared.prepare_task_groups(&TaskGroup::STANDARD).unwrap();
        prepared.step(&action(0), b.step_results_mut()).unwrap();
        assert_eq!((&a.images, &a.vectors), (&b.images, &b.vectors), "{group}");
    }
}

/// Returns settings with pictures that cannot be randomised.
fn randomised(extra_views: ExtraViews) -> VecEnvSettings {
    VecEnvSettings {
        camera: Camera { extra_views, ..Camera::default() },
        randomisation: Some(VisualDomainRandomisation::NOMINAL),
        ..settings(1)
    }
}

#[test]
fn settings_out_of_range_are_refused() {
    for broken in [
        VecEnvSettings { num_envs: 0, ..settings(1) },
        VecEnvSettings { threads: 0, ..settings(1) },
        VecEnvSettings { threads: 1025, ..settings(1) },
        VecEnvSettings { camera: Camera { size: 15, ..Camera::default() }, ..settings(1) },
        randomised(ExtraViews::CloseUp),
        randomised(ExtraViews::FirstAndCloseUp),
    ] {
        let error = VecEnv::new(broken, TaskGroup::GOAL_REACH, &D2::ALL).err().unwrap();
        assert!(matches!(error, EnvError::InvalidSetting { .. }), "{error}");
    }
}

#[test]
fn restored_episodes_continue_to_the_same_bits_in_any_vector_of_the_task() {
    let randomisation = Some(VisualDomainRandomisation::default());
    let settings = VecEnvSettings { randomisation, ..settings(2) };
    let make = |group| VecEnv::new(settings, group, &D2::ALL).unwrap();
    let mut env = make(TaskGroup::DRAWER_CLOSE);
    let mut buffers = StepBuffers::new(&settings);
    assert!(matches!(env.save(), Err(EnvError::NotReset)));
    env.reset(buffers.observations_mut()).unwrap();
    env.step(&action(0), buffers.step_results_mut()).unwrap();
    let (saved, last) = (env.save().unwrap(), buffers.vectors.clone());
    // over the end of an episode, so that random streams count, too
    let run = |vector: &mut VecEnv| {
        let mut out = StepBuffers::new(&settings);
        let steps = (1..8).map(|step| {
            vector.step(&action(step), out.step_results_mut()).unwrap();
            (out.images.clone(), out.vectors.clone(), out.rewards.clone())
        });
        steps.collect::<Vec<_>>()
    };
    let expected = run(&mut env);
    for other in [&mut env, &mut make(TaskGroup::DRAWER_CLOSE)] {
        other.restore(&saved, buffers.observations_mut()).unwrap();
        assert_eq!(buffers.vectors, last);
        assert!(run(other) == expected);
    }
    let mut wrong = make(TaskGroup::GOAL_REACH);
    let error = wrong.restore(&saved, buffers.observations_mut()).unwrap_err().to_string();
    assert!(error.contains("drawer-close"), "{error}");
    assert!(env.restore(&saved[1..], buffers.observations_mut()).is_err());
    // whose pictures would be those of the other camera until the next step
    let camera = Camera { half_extent: 0.3, ..settings.camera };
    for other in [VecEnvSettings { camera, ..settings }, self::settings(2)] {
        let mut seeing = VecEnv::new(other, TaskGroup::DRAWER_CLOSE, &D2::ALL).unwrap();
        seeing.reset(buffers.observations_mut()).unwrap();
        let refused = seeing.restore(&saved, buffers.observations_mut()).unwrap_err();
        assert!(matches!(refused, EnvError::SceneMismatch { .. }), "{refused}");
        seeing.step(&action(0), buffers.step_results_mut()).unwrap();
    }
}

#[test]
fn seeds_of_their_own_give_the_episodes_of_single_environments() {
    let settings = settings(2);
    let mut env = VecEnv::new(settings, TaskGroup::DRAWER_CLOSE, &D2::ALL).unwrap();
    env.reseed_each(&[5, 6, 5]).unwrap();
    let mut buffers = StepBuffers::new(&settings);
    env.reset(buffers.observations_mut()).unwrap();
    let image = settings.image_len();
    assert!(buffers.images[..image] == buffers.images[2 * image..]);
    let single = VecEnvSettings { num_envs: 1, seed: 6, ..settings };
    let mut alone = StepBuffers::new(&single);
    let mut env_alone = VecEnv::new(single, TaskGroup::DRAWER_CLOSE, &D2::ALL).unwrap();
    env_alone.reset(alone.observations_mut()).unwrap();
    assert!(buffers.images[image..2 * image] == alone.images);
    assert!(env.reseed_each(&[1]).is_err());
}

#[test]
fn details_tell_where_the_object_is_and_how_far_from_its_goal() {
    let settings = settings(2);
    let mut env = VecEnv::new(settings, TaskGroup::DRAWER_CLOSE, &D2::ALL).unwrap();
    let mut buffers = StepBuffers::new(&settings);
    let mut details = [0.0; N * STATE_DETAILS_DIM];
    assert!(matches!(env.state_details(&mut details), Err(EnvError::NotReset)));
    env.reset(buffers.observations_mut()).unwrap();
    env.step(&action(0), buffers.step_results_mut()).unwrap();
    env.state_details(&mut details).unwrap();
    let vectors = buffers.vectors.chunks(VECTOR_OBSERVATION_DIM);
    for (row, vector) in details.chunks(STATE_DETAILS_DIM).zip(vectors) {
        assert_eq!(row[..4], vector[..4]);
        let distance = (0..3).map(|i| (row[4 + i] - row[10 + i]).powi(2)).sum::<f32>().sqrt();
        assert!((row[15] - distance).abs() < 1e-5 && distance > 0.05, "{row:?}");
        assert!(row[13..15].iter().all(|term| (0.0..=1.0).contains(term)));
    }
    // the experts' actions are not taken
    let mut actions = [0.0; N * ACTION_DIM];
    env.expert_actions(&mut actions).unwrap();
    let mut again = [0.0; N * STATE_DETAILS_DIM];
    env.state_details(&mut again).unwrap();
    assert_eq!(again, details);
}
