//! Environments with randomised pictures compared to those with perfect ones.

use envs::{
    ACTION_DIM, ExtraViews, StepBuffers, TaskGroup, VecEnv, VecEnvSettings,
    VisualDomainRandomisation,
};
use symmetry::D2;

const N: usize = 3;
/// Steps of a run over two ends of episodes of six decisions.
const STEPS: usize = 14;

fn settings(threads: usize, randomisation: Option<VisualDomainRandomisation>) -> VecEnvSettings {
    let mut settings = VecEnvSettings {
        num_envs: N,
        threads,
        seed: 11,
        randomisation,
        ..VecEnvSettings::default()
    };
    settings.control.horizon = 60;
    settings
}

/// Everything that some steps of a group return, starting with the reset.
fn walk(settings: VecEnvSettings, group: TaskGroup, seed: Option<u64>) -> Vec<StepBuffers> {
    let mut env = VecEnv::new(settings, group, &D2::ALL).unwrap();
    let mut batch = StepBuffers::new(&settings);
    if let Some(seed) = seed {
        env.reset(batch.observations_mut()).unwrap();
        env.reseed(seed).unwrap();
    }
    env.reset(batch.observations_mut()).unwrap();
    let mut seen = vec![batch.clone()];
    for step in 0..STEPS {
        let action = |i: usize| ((i * 7 + step * 3) % 5) as f32 / 2.0 - 1.0;
        let actions: Vec<f32> = (0..N * ACTION_DIM).map(action).collect();
        env.step(&actions, batch.step_results_mut()).unwrap();
        seen.push(batch.clone());
    }
    seen
}

#[test]
fn amounts_of_zero_show_what_perfect_pictures_show() {
    let group = TaskGroup::DRAWER_CLOSE;
    let clean = walk(settings(2, None), group, None);
    let off = walk(settings(2, Some(VisualDomainRandomisation::OFF)), group, None);
    assert!(off == clean);
}

#[test]
fn pictures_alone_are_others_and_they_have_the_same_shape() {
    let group = TaskGroup::PLATE_SLIDE;
    let clean = walk(settings(2, None), group, None);
    let random = walk(settings(2, Some(VisualDomainRandomisation::NOMINAL)), group, None);
    for (clean_batch, random_batch) in clean.iter().zip(&random) {
        assert_eq!(random_batch.images.len(), clean_batch.images.len());
        let image = clean_batch.images.len() / N;
        for (clean_image, random_image) in
            clean_batch.images.chunks(image).zip(random_batch.images.chunks(image))
        {
            let off = clean_image.iter().zip(random_image).map(|(a, b)| f64::from(a.abs_diff(*b)));
            let off = off.sum::<f64>() / image as f64;
            assert!(off > 1.0 && off < 60.0, "{off} levels off on average");
        }
        let same = StepBuffers {
            images: clean_batch.images.clone(),
            final_images: clean_batch.final_images.clone(),
            ..random_batch.clone()
        };
        assert!(same == *clean_batch, "placements, vectors and rewards stay");
    }
}

#[test]
fn any_number_of_threads_shows_the_same_and_so_does_a_seed_given_later() {
    let amounts = Some(VisualDomainRandomisation::NOMINAL);
    let group = TaskGroup::BUTTON_PRESS;
    let one = walk(settings(1, amounts), group, None);
    for threads in [2, 3] {
        assert!(walk(settings(threads, amounts), group, None) == one, "{threads} threads");
    }
    assert!(walk(settings(2, amounts), group, Some(11)) == one);
    assert!(walk(settings(2, amounts), group, Some(12)) != one);
}

/// Light and white balance are measured in a corner of the table, where nothing moves.
#[test]
fn the_first_picture_has_the_camera_of_its_episode_and_the_next_episode_another() {
    let amounts = VisualDomainRandomisation {
        exposure_sd: 20.0,
        white_balance_sd: 10.0,
        ..VisualDomainRandomisation::OFF
    };
    let walk = walk(settings(2, Some(amounts)), TaskGroup::GOAL_REACH, None);
    let corners = |batch: &StepBuffers| -> Vec<Vec<u8>> {
        let image = batch.images.len() / N;
        let images = batch.images.chunks(image);
        images.map(|pixels| pixels[..ExtraViews::First.num_total_channels()].to_vec()).collect()
    };
    let mut episodes = vec![corners(&walk[0])];
    for (step, batch) in walk.iter().enumerate().skip(1) {
        if batch.truncated[0] {
            assert_ne!(episodes.last(), Some(&corners(batch)), "step {step}");
            episodes.push(corners(batch));
        }
        let constant = episodes.last().unwrap();
        assert_eq!(corners(batch), *constant, "step {step}");
        assert!(constant.iter().all(|corner| corner[..3] == corner[3..]));
        assert!(constant[0] != constant[1] && constant[1] != constant[2]);
    }
    assert_eq!(episodes.len(), 3);
}

#[test]
fn settings_may_leave_it_out() {
    let clean = serde_json::to_string(&settings(2, None)).unwrap();
    let without = clean.replace("\"randomisation\":null,", "");
    assert_ne!(without, clean);
    assert_eq!(serde_json::from_str::<VecEnvSettings>(&without).unwrap(), settings(2, None));
    let random = settings(2, Some(VisualDomainRandomisation::NOMINAL));
    let text = serde_json::to_string(&random).unwrap();
    assert_eq!(serde_json::from_str::<VecEnvSettings>(&text).unwrap(), random);
    assert_eq!(random.for_evaluation(), settings(2, None));
    let mut wild = VisualDomainRandomisation::NOMINAL;
    wild.max_position_error_mm = 500.0;
    let refused = VecEnv::new(settings(2, Some(wild)), TaskGroup::GOAL_REACH, &D2::ALL);
    let message = refused.err().unwrap().to_string();
    assert!(message.contains("`max_position_error_mm` is 500, expected 0 to 100 mm"), "{message}");
}
