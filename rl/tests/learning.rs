//! PPO learns a toy task from pixels within seconds, and a frozen policy does not pass the same
//! threshold.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Algorithm, Encoder, Ppo, PpoSettings, RolloutBuffer, RolloutState,
    VectorEnv, collect,
};

use crate::common::joint::joint;
use crate::common::{EPISODE, PointReach};

const ROLLOUTS: usize = 25;
/// Of at most 10 an episode.
const THRESHOLD: f64 = 7.5;

/// Mean return of the last of [`ROLLOUTS`] rollouts of 320 decisions.
fn last_return(encoder: Encoder, learn: bool) -> f64 {
    let mut env = PointReach::new(32, 1);
    let network = joint(encoder, 8);
    let settings = PpoSettings {
        encoder_learning_rate: 1e-3,
        gamma: 0.9,
        ..PpoSettings::measured()
    };
    let mut policy = ActorCriticPolicy::new(&network, env.spec(), 2).unwrap();
    let mut ppo = Ppo::new(settings, &policy).unwrap();
    let mut buffer = RolloutBuffer::new(env.spec(), EPISODE).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut state = RolloutState::reset(&mut env, &policy).unwrap();
    let mut last = 0.0;
    for _ in 0..ROLLOUTS {
        let stats = collect(&mut env, &mut policy, &mut buffer, &mut state, &mut rng).unwrap();
        last = stats.mean_return().unwrap();
        if learn {
            ppo.update(&mut policy, &buffer, &mut rng).unwrap();
        }
    }
    last
}

fn assert_learns(encoder: Encoder) {
    let [frozen, learned] = [false, true].map(|learn| last_return(encoder.clone(), learn));
    assert!(learned > THRESHOLD, "{encoder:?} learned {learned}");
    assert!(frozen < THRESHOLD - 1.5, "{encoder:?} frozen {frozen}");
}

#[test]
fn a_strided_encoder_reaches_a_return_that_a_frozen_policy_does_not() {
    assert_learns(Encoder::Strided { fields: vec![4] });
}

#[test]
fn a_pooled_encoder_reaches_a_return_that_a_frozen_policy_does_not() {
    assert_learns(Encoder::Pooled {
        fields: vec![],
        inner: [4, 4],
    });
}

#[test]
fn keypoints_reach_a_return_that_a_frozen_policy_does_not() {
    assert_learns(Encoder::Keypoints {
        fields: vec![4],
        maps: 4,
    });
}
