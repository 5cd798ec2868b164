//! The replay against a list that forgets nothing.

use proptest::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    EnvSpec, Observations, ReplayBuffer, ReplaySettings, ReplayStep, RlError, StepOutcome,
    Transition,
};

use crate::common::episodes::{Episodes, Step, settings, spec};

/// Records `count` steps of every environment, with a reset before each of the steps in `resets`.
fn fill(
    episodes: &mut Episodes,
    replay: &mut ReplayBuffer,
    count: usize,
    resets: &[usize],
) -> Vec<Step> {
    let mut all = Vec::new();
    for i in 0..count {
        if resets.contains(&i) {
            episodes.reset();
            replay.cut_running_episodes();
        }
        all.extend(episodes.record(replay).unwrap());
    }
    all
}

/// Returns `true` if a recorded step equals `step`.
fn is(recorded: ReplayStep, step: &Step) -> bool {
    let [mut image, mut next] = [(); 2].map(|()| vec![0; 18]);
    recorded.write_image(&mut image);
    recorded.write_next_image(&mut next);
    image == step.seen.image()
        && next == step.next().image()
        && recorded.observation_vector() == step.seen.vector()
        && recorded.next_observation_vector() == step.next().vector()
        && recorded.action() == step.seen.action()
        && recorded.reward() == step.seen.reward()
        && recorded.outcome() == step.outcome
        && recorded.index_in_episode() == step.seen.at
}

/// Compares every step that is held, and every step before it, with all steps ever taken.
fn check(replay: &ReplayBuffer, all: &[Step]) {
    let held = replay.len();
    assert_eq!(held, all.len().min(replay.settings().capacity));
    assert_eq!(replay.total_recorded_steps(), all.len() as u64);
    for (i, step) in all[all.len() - held..].iter().enumerate() {
        let recorded = replay.get(i);
        assert!(is(recorded, step), "{i}: {recorded:?} {step:?}");
        for count in 1..=step.seen.at {
            let mut seen = step.seen;
            seen.at -= count;
            let outcome = StepOutcome::Running;
            let earlier = recorded.nth_step_before(count).unwrap();
            assert!(is(earlier, &Step { seen, outcome }), "{i}, {count}");
        }
        assert!(recorded.nth_step_before(step.seen.at + 1).is_none(), "{i}");
    }
}

fn indices(replay: &ReplayBuffer, newest: f32, seed: u64) -> Vec<usize> {
    let mut out = Vec::new();
    replay.sample_indices(200, newest, &mut ChaCha8Rng::seed_from_u64(seed), &mut out);
    out
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever the lengths of the episodes and wherever resets come, the ring holds the latest
    /// steps, and the steps before one are those of its own episode. A copy from its saved state
    /// samples the same and goes on alike.
    #[test]
    fn the_ring_holds_the_latest_steps_and_survives_a_file(
        lengths in prop::collection::vec(1usize..9, 1..5),
        capacity in 1usize..40,
        count in 1usize..40,
        resets in prop::collection::vec(1usize..40, 0..3),
        mark in any::<bool>(),
    ) {
        let envs = lengths.len();
        let mut episodes = Episodes::new(&lengths);
        let mut replay = ReplayBuffer::new(settings(capacity), &spec(envs)).unwrap();
        let mut all = fill(&mut episodes, &mut replay, count, &resets);
        check(&replay, &all);
        if mark {
            replay.mark_newest_from_now();
        }
        let mut copy = ReplayBuffer::restore(settings(capacity), &spec(1), &replay.checkpoint_state()).unwrap();
        prop_assert_eq!(copy.checkpoint_state(), replay.checkpoint_state());
        check(&copy, &all);
        for seed in 0..3 {
            prop_assert_eq!(indices(&copy, 0.5, seed), indices(&replay, 0.5, seed));
        }
        fill(&mut episodes.clone(), &mut copy, 7, &[3]);
        all.extend(fill(&mut episodes, &mut replay, 7, &[3]));
        check(&copy, &all);
        prop_assert_eq!(copy.checkpoint_state(), replay.checkpoint_state());
    }
}

#[test]
fn a_share_of_a_minibatch_is_the_newest_experience() {
    let (mut episodes, mut replay) = (Episodes::new(&[5, 3]), replay_of(2, 60));
    let newest = |any: &ReplayBuffer, share: f32, from: usize| {
        let drawn = indices(any, share, 1);
        assert_eq!(drawn.len(), 200);
        assert!(drawn.iter().all(|&i| i < any.len()));
        drawn.into_iter().filter(|&i| i >= from).count()
    };
    fill(&mut episodes, &mut replay, 20, &[]);
    // without a mark, all is the newest; right after one, nothing is
    assert_eq!(newest(&replay, 1.0, 0), 200);
    replay.mark_newest_from_now();
    let last_quarter = newest(&replay, 1.0, 30);
    assert!((25..75).contains(&last_quarter), "{last_quarter}");
    fill(&mut episodes, &mut replay, 5, &[]);
    assert_eq!(newest(&replay, 1.0, 40), 200);
    let half = newest(&replay, 0.5, 40);
    assert!((101..160).contains(&half), "100 and a fifth of 100: {half}");
    assert!(newest(&replay, 0.0, 40) < 75);
    replay.mark_newest_steps(4);
    assert_eq!(newest(&replay, 1.0, 46), 200, "the last four of fifty");
    replay.mark_newest_steps(1000);
    assert!(newest(&replay, 1.0, 46) < 50);
    // what is older than the ring counts no more
    fill(&mut episodes, &mut replay, 100, &[]);
    assert_eq!(newest(&replay, 1.0, 0), 200);
}

fn replay_of(envs: usize, capacity: usize) -> ReplayBuffer {
    ReplayBuffer::new(settings(capacity), &spec(envs)).unwrap()
}

/// An episode that never ends does not fill the memory, and contexts still find their steps.
#[test]
fn an_endless_episode_is_forgotten_from_its_front() {
    let (mut episodes, mut replay) = (Episodes::new(&[usize::MAX]), replay_of(1, 50));
    let mut most = 0;
    for _ in 0..20 {
        fill(&mut episodes, &mut replay, 200, &[]);
        most = most.max(replay.allocated_bytes());
        let oldest = replay.get(0);
        let count = oldest.index_in_episode().min(256);
        assert_eq!(
            oldest.nth_step_before(count).unwrap().index_in_episode(),
            oldest.index_in_episode() - count
        );
    }
    let step = 12 + 5 * size_of::<f32>();
    assert!(most < 2000 * step, "{most}");
    let copy = ReplayBuffer::restore(settings(50), &spec(1), &replay.checkpoint_state()).unwrap();
    assert_eq!(copy.checkpoint_state(), replay.checkpoint_state());
}

/// 64 x 64 pixels with three channels that move and three that stand still, in episodes of 50
/// steps: 200,000 of them are under 3 GB.
#[test]
fn a_step_takes_little_more_than_its_picture() {
    let spec = EnvSpec { num_envs: 4, image_shape: [64, 64, 6], ..spec(4) };
    let settings =
        ReplaySettings { capacity: 4000, still_channels: 3, ..ReplaySettings::default() };
    let mut replay = ReplayBuffer::new(settings, &spec).unwrap();
    let now = Observations::new(&spec);
    for step in 1..=1200 {
        let mut transition = Transition::new(&spec);
        if step % 50 == 0 {
            transition.outcomes.fill(StepOutcome::Truncated);
        }
        replay.push(&now, &[0.0; 8], &transition).unwrap();
    }
    let bytes = replay.allocated_bytes() / replay.len();
    assert!((64 * 64 * 3..14_000).contains(&bytes), "{bytes}");
    assert!(200_000 * bytes < 3_000_000_000);
}

#[test]
fn a_step_that_does_not_follow_is_refused_until_the_episodes_are_cut() {
    let (mut episodes, mut replay) = (Episodes::new(&[9, 9]), replay_of(2, 60));
    let mut all = fill(&mut episodes, &mut replay, 3, &[]);
    episodes.reset();
    let result = episodes.clone().record(&mut replay);
    assert!(matches!(result, Err(RlError::EpisodeNotContinued { env: 0 })));
    check(&replay, &all);
    replay.cut_running_episodes();
    all.extend(fill(&mut episodes, &mut replay, 2, &[]));
    check(&replay, &all);
    // one environment alone leaves its episode
    let (mut now, actions, transition, _) = episodes.step();
    *now.vectors.last_mut().unwrap() += 1.0;
    let pushed = replay.push(&now, &actions, &transition);
    assert!(matches!(pushed, Err(RlError::EpisodeNotContinued { env: 1 })));
}

/// Function that spoils a step, and the beginning of the error.
type Case = (fn(&mut Observations, &mut Vec<f32>, &mut Transition), &'static str);

#[test]
fn what_cannot_be_right_is_refused_and_changes_nothing() {
    let still = "the last 1 channels of the image of environment 1 differ";
    let cases: [Case; 7] = [
        (|_, _, t| t.rewards[1] = f32::NAN, "a reward is NaN"),
        (|_, actions, _| actions[3] = f32::INFINITY, "an action is inf"),
        (|now, _, _| now.vectors[0] = f32::NAN, "a component of an observation vector is NaN"),
        (
            |_, _, t| t.observations.vectors[0] = f32::NAN,
            "a component of an observation vector is NaN",
        ),
        (|_, _, t| *t.observations.images.last_mut().unwrap() ^= 1, still),
        (|_, actions, _| actions.push(0.0), "actions: got 5 values"),
        (|now, _, _| now.images.truncate(35), "images: got 35 values"),
    ];
    let (mut episodes, mut replay) = (Episodes::new(&[9, 9]), replay_of(2, 60));
    let all = fill(&mut episodes, &mut replay, 3, &[]);
    for (spoil, expected) in cases {
        let (mut now, mut actions, mut transition, _) = episodes.clone().step();
        spoil(&mut now, &mut actions, &mut transition);
        let error = replay.push(&now, &actions, &transition).unwrap_err();
        assert!(error.to_string().starts_with(expected), "{error}");
        check(&replay, &all);
    }
}

static NAN: [f32; 16] = [f32::NAN; 16];

#[test]
fn a_damaged_state_is_refused() {
    let (mut episodes, mut replay) = (Episodes::new(&[4, 9]), replay_of(2, 12));
    fill(&mut episodes, &mut replay, 11, &[]);
    let state = replay.checkpoint_state();
    let refused = |spoil: &dyn Fn(&mut rl::ReplayState)| {
        let mut wrong = state.clone();
        spoil(&mut wrong);
        ReplayBuffer::restore(settings(12), &spec(2), &wrong).unwrap_err()
    };
    let damaged = |error| matches!(error, RlError::InvalidStateNumber { .. });
    assert!(damaged(refused(&|s| s.step_order[3][0] = 99)));
    assert!(damaged(refused(&|s| s.step_order[3][1] = 99)));
    assert!(damaged(refused(&|s| s.total_recorded_steps = 3)));
    assert!(damaged(refused(&|s| s.num_before_newest = 1000)));
    assert!(damaged(refused(&|s| s.running_episodes[0] = Some(99))));
    assert!(damaged(refused(&|s| s.running_episodes[1] = Some(0))));
    let short = |error| matches!(error, RlError::ShapeMismatch { what: "moving", .. });
    assert!(short(refused(&|s| s.stored_episodes[1].moving = &[])));
    let rewards =
        refused(&|s| s.stored_episodes[1].rewards = &NAN[..s.stored_episodes[1].rewards.len()]);
    assert!(matches!(rewards, RlError::NotFinite { .. }), "{rewards}");
}
