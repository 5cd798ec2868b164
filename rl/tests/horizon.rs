//! Rollouts that are shorter than an episode.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Encoder, NetworkSettings, RlError, RolloutBuffer, RolloutState, VectorEnv,
    collect,
};

use crate::common::ages::Ages;
use crate::common::{EPISODE, PointReach};

#[test]
fn a_rollout_shorter_than_an_episode_is_refused_with_both_numbers() {
    let env = PointReach::new(2, 0);
    let horizon = env.horizon().unwrap();
    let buffer = |steps| RolloutBuffer::new(env.spec(), steps).unwrap();
    assert!(buffer(EPISODE).check_horizon(horizon).is_ok());
    let error = buffer(EPISODE - 1).check_horizon(horizon).unwrap_err();
    assert!(matches!(
        error,
        RlError::ShortRollout {
            steps: 9,
            horizon: 10
        }
    ));
    let message = error.to_string();
    assert!(
        message.starts_with("rollouts of 9 steps end before an episode of 10 steps does"),
        "{message}"
    );
    assert_eq!(Ages::new(&[3, 7, 5]).horizon(), Some(7));
}

/// Returns that three rollouts of 4 steps report, where an episode has 10, and whether a late state
/// was met.
fn short_rollouts(reset: bool) -> [bool; 2] {
    let mut env = PointReach::new(2, 0);
    let settings = NetworkSettings {
        encoder: Encoder::Strided { fields: vec![2] },
        ..NetworkSettings::default()
    };
    let mut policy = ActorCriticPolicy::new(&settings, env.spec(), 0).unwrap();
    let mut buffer = RolloutBuffer::new(env.spec(), 4).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut state = RolloutState::reset(&mut env, &policy).unwrap();
    let (mut returns, mut late) = (false, false);
    for _ in 0..3 {
        if reset {
            state = RolloutState::reset(&mut env, &policy).unwrap();
        }
        let stats = collect(&mut env, &mut policy, &mut buffer, &mut state, &mut rng).unwrap();
        returns |= stats.mean_return().is_some();
        late |= state.episodes.iter().any(|e| e.length > 4) || returns;
    }
    [returns, late]
}

/// What the documentation of `collect` says, and why `check_horizon` is there.
#[test]
fn short_rollouts_meet_late_states_only_where_episodes_go_on() {
    assert_eq!(short_rollouts(true), [false, false]);
    assert_eq!(short_rollouts(false), [true, true]);
}

/// As after a cut: what was left has been learnt from.
#[test]
fn after_a_rollout_that_lost_its_end_the_next_is_whole() {
    let mut env = PointReach::new(2, 0);
    let settings = NetworkSettings {
        encoder: Encoder::Strided { fields: vec![2] },
        ..NetworkSettings::default()
    };
    let mut policy = ActorCriticPolicy::new(&settings, env.spec(), 0).unwrap();
    let mut buffer = RolloutBuffer::new(env.spec(), 4).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut state = RolloutState::reset(&mut env, &policy).unwrap();
    for _ in 0..2 {
        let stats = collect(&mut env, &mut policy, &mut buffer, &mut state, &mut rng).unwrap();
        assert_eq!((stats.decisions, buffer.steps()), (8, 4));
        buffer.truncate(3).unwrap();
        assert_eq!(buffer.steps(), 3);
    }
}
