//! Soft actor-critic learns toy tasks within seconds, from vectors, from pixels and with a memory,
//! and a policy that does not learn, or does not remember, does not pass the same thresholds.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    Algorithm, ContextSettings, Encoder, NetworkSettings, Replay, ReplaySettings, RolloutState,
    Sac, SacPolicy, SacSettings, VectorEnv, collect, evaluate,
};
use symmetry::Group;

use crate::common::PointReach;
use crate::common::guess::Guess;
use crate::common::joint::joint;

const ENVS: usize = 16;

fn network(group: Group, encoder: Encoder) -> NetworkSettings {
    NetworkSettings {
        group,
        ..joint(encoder, 8)
    }
}

fn settings() -> SacSettings {
    SacSettings {
        gamma: 0.8,
        batch: 64,
        updates_per_step: 0.2,
        burn_in: 200,
        learning_rate: 3e-3,
        tau: 0.02,
        ..SacSettings::default()
    }
}

/// Mean return of the mean actions after this many collections of one episode in every environment.
fn learned(
    env: &mut dyn VectorEnv,
    network: &NetworkSettings,
    context: Option<ContextSettings>,
    turns: usize,
) -> f64 {
    let spec = env.spec().clone();
    let mut policy = SacPolicy::new(network, context, &spec, 2).unwrap();
    let mut sac = Sac::new(settings(), &policy).unwrap();
    let replay = ReplaySettings {
        capacity: 4000,
        steps: env.horizon().unwrap(),
        warm_up: 200,
        ..ReplaySettings::default()
    };
    let mut replay = Replay::new(replay, &spec).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut state = RolloutState::reset(env, &policy).unwrap();
    for _ in 0..turns {
        collect(env, &mut policy, &mut replay, &mut state, &mut rng).unwrap();
        sac.update(&mut policy, &replay, &mut rng).unwrap();
    }
    evaluate(env, &mut policy, 4)
        .unwrap()
        .mean_return()
        .unwrap()
}

/// Of 8 at most. A policy that stands still gets 8 * (1 - 0.45).
#[test]
fn a_goal_that_is_shown_is_learnt_from_vectors() {
    for group in [Group::D2, Group::C1] {
        let run = |turns| {
            let network = network(group, Encoder::Blind);
            learned(&mut Guess::new(ENVS, true, 1), &network, None, turns)
        };
        let (frozen, learned) = (run(0), run(25));
        assert!(learned > 7.2, "{group}: learned {learned}");
        assert!(frozen < 5.5, "{group}: frozen {frozen}");
    }
}

/// Of 8 at most; the first decision of an episode is a guess. Without a context every one is.
#[test]
fn a_goal_that_only_rewards_tell_is_learnt_with_a_context() {
    let run = |context| {
        let network = network(Group::C1, Encoder::Blind);
        learned(&mut Guess::new(ENVS, false, 1), &network, context, 40)
    };
    let remembering = run(Some(ContextSettings { size: 8, length: 2 }));
    let forgetful = run(None);
    assert!(remembering > 5.0, "remembering {remembering}");
    assert!(forgetful < 2.0, "forgetful {forgetful}");
}

/// Of 10 at most, as in PPO's test.
#[test]
fn a_goal_in_a_picture_is_learnt_from_pixels() {
    let run = |turns| {
        let network = network(Group::D2, Encoder::Strided { fields: vec![4] });
        learned(&mut PointReach::new(ENVS, 1), &network, None, turns)
    };
    let (frozen, learned) = (run(0), run(25));
    assert!(learned > 7.5, "learned {learned}");
    assert!(frozen < 6.0, "frozen {frozen}");
}
