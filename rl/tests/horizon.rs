//! Rollouts that are shorter than an episode.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Encoder, NetworkSettings, RlError, RolloutBuffer, RolloutState,
    RolloutStats, VectorEnv, collect,
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

/// Points, a policy, and rollouts of 4 steps, where an episode has 10.
struct Short {
    env: PointReach,
    policy: ActorCriticPolicy,
    buffer: RolloutBuffer,
    rng: ChaCha8Rng,
}

impl Short {
    fn new() -> Self {
        let env = PointReach::new(2, 0);
        let settings = NetworkSettings {
            encoder: Encoder::Strided { fields: vec![2] },
            ..NetworkSettings::default()
        };
        Self {
            policy: ActorCriticPolicy::new(&settings, env.spec(), 0).unwrap(),
            buffer: RolloutBuffer::new(env.spec(), 4).unwrap(),
            rng: ChaCha8Rng::seed_from_u64(0),
            env,
        }
    }

    fn reset(&mut self) -> RolloutState {
        RolloutState::reset(&mut self.env, &self.policy).unwrap()
    }

    fn collect(&mut self, state: &mut RolloutState) -> RolloutStats {
        let (env, policy) = (&mut self.env, &mut self.policy);
        collect(env, policy, &mut self.buffer, state, &mut self.rng).unwrap()
    }
}

/// Returns that three rollouts report, and whether a late state was met.
fn short_rollouts(reset: bool) -> [bool; 2] {
    let mut short = Short::new();
    let mut state = short.reset();
    let (mut returns, mut late) = (false, false);
    for _ in 0..3 {
        if reset {
            state = short.reset();
        }
        returns |= short.collect(&mut state).mean_return().is_some();
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
    let mut short = Short::new();
    let mut state = short.reset();
    for _ in 0..2 {
        let stats = short.collect(&mut state);
        assert_eq!((stats.decisions, short.buffer.steps()), (8, 4));
        short.buffer.truncate(3).unwrap();
        assert_eq!(short.buffer.steps(), 3);
    }
}
