//! Training works: PPO from images, soft actor-critic from vectors, memories and images.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Algorithm, EncoderSettings, EnvSpec, NetworkSettings, Ppo, PpoSettings,
    RecurrentContextSettings, ReplayBuffer, ReplaySettings, RolloutState, Sac, SacPolicy,
    SacSettings, VectorEnv, collect_experience, evaluate_policy,
};
use symmetry::Group;

use crate::common::guess::Guess;
use crate::common::steps::{OnPolicyRun, joint};
use crate::common::{EPISODE, PointReach};

const ROLLOUTS: usize = 25;
/// Required mean return, of at most 10.
const THRESHOLD: f64 = 7.5;

/// Returns the mean return of the last of [`ROLLOUTS`] rollouts of 320 decisions.
fn last_return(env: PointReach, encoder: EncoderSettings, learn: bool) -> f64 {
    let settings = PpoSettings { encoder_learning_rate: 1e-3, gamma: 0.9, ..PpoSettings::tuned() };
    let policy = ActorCriticPolicy::new(&joint(encoder, 8), env.spec(), 2).unwrap();
    let mut ppo = Ppo::new(settings, &policy).unwrap();
    let mut run = OnPolicyRun::new(env, policy, EPISODE);
    let mut last = 0.0;
    for _ in 0..ROLLOUTS {
        last = run.collect().mean_return().unwrap();
        if learn {
            ppo.update(&mut run.policy, &run.buffer, &mut run.rng).unwrap();
        }
    }
    last
}

/// Checks that training reaches a return that a frozen policy does not.
fn assert_learns(env: &PointReach, encoder: EncoderSettings) {
    let last = |learn| last_return(env.clone(), encoder.clone(), learn);
    let [frozen, learned] = [false, true].map(last);
    assert!(learned > THRESHOLD, "{encoder:?} learned {learned}");
    assert!(frozen < THRESHOLD - 1.5, "{encoder:?} frozen {frozen}");
}

#[test]
fn ppo_learns_with_a_strided_encoder() {
    assert_learns(&PointReach::new(32, 1), EncoderSettings::Strided { fields: vec![4] });
}

#[test]
fn ppo_learns_with_a_pooled_encoder() {
    assert_learns(
        &PointReach::new(32, 1),
        EncoderSettings::Pooled { fields: vec![], inner: [4, 4] },
    );
}

#[test]
fn ppo_learns_from_vectors_alone() {
    let env = PointReach::showing(32, 1, EnvSpec::NO_IMAGE, 4);
    assert_learns(&env, EncoderSettings::Blind);
}

#[test]
fn ppo_learns_from_pictures_alone_that_are_not_square() {
    let encoder = EncoderSettings::Strided { fields: vec![4] };
    assert_learns(&PointReach::showing(32, 1, [8, 12, 2], 0), encoder);
}

const ENVS: usize = 16;

fn network(group: Group, encoder: EncoderSettings) -> NetworkSettings {
    NetworkSettings { group, ..joint(encoder, 8) }
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

/// Returns the mean return of mean actions after this many collections of one episode in every
/// environment.
fn learned(
    env: &mut dyn VectorEnv,
    network: &NetworkSettings,
    context: Option<RecurrentContextSettings>,
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
    let mut replay = ReplayBuffer::new(replay, &spec).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut state = RolloutState::from_env_reset(env, &policy).unwrap();
    for _ in 0..turns {
        collect_experience(env, &mut policy, &mut replay, &mut state, &mut rng).unwrap();
        sac.update(&mut policy, &replay, &mut rng).unwrap();
    }
    evaluate_policy(env, &mut policy, 4).unwrap().mean_return().unwrap()
}

/// Returns are at most 8. A policy that stands still gets 8 * (1 - 0.45).
#[test]
fn a_goal_that_is_shown_is_learnt_from_vectors() {
    for group in [Group::D2, Group::C1] {
        let run = |turns| {
            let network = network(group, EncoderSettings::Blind);
            learned(&mut Guess::new(ENVS, true, 1), &network, None, turns)
        };
        let (frozen, learned) = (run(0), run(25));
        assert!(learned > 7.2, "{group}: learned {learned}");
        assert!(frozen < 5.5, "{group}: frozen {frozen}");
    }
}

/// Returns are at most 8; the first decision of an episode is a guess. Without a context every one
/// is.
#[test]
fn a_goal_that_only_rewards_tell_is_learnt_with_a_context() {
    let run = |context| {
        let network = network(Group::C1, EncoderSettings::Blind);
        learned(&mut Guess::new(ENVS, false, 1), &network, context, 40)
    };
    let remembering = run(Some(RecurrentContextSettings { size: 8, length: 2 }));
    let forgetful = run(None);
    assert!(remembering > 5.0, "remembering {remembering}");
    assert!(forgetful < 2.0, "forgetful {forgetful}");
}

/// Returns are at most 10, as in PPO's test.
#[test]
fn a_goal_in_a_picture_is_learnt_from_pixels() {
    let run = |turns| {
        let network = network(Group::D2, EncoderSettings::Strided { fields: vec![4] });
        learned(&mut PointReach::new(ENVS, 1), &network, None, turns)
    };
    let (frozen, learned) = (run(0), run(25));
    assert!(learned > 7.5, "learned {learned}");
    assert!(frozen < 6.0, "frozen {frozen}");
}
