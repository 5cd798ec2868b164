//! Reward scales other than 1: the range in which PPO trains, and the warning outside of it.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Algorithm, BoxedEnvError, EncoderSettings, EnvSpec,
    MAX_RECOMMENDED_ABS_RETURN, MIN_RECOMMENDED_ABS_RETURN, NormalisationSettings, NormalisedEnv,
    Observations, Ppo, PpoSettings, RewardWarning, RolloutBuffer, RolloutState, RolloutStats,
    Transition, VectorEnv, evaluate_policy,
};
use symmetry::Irrep;

use crate::common::PointReach;
use crate::common::steps::{OnPolicyRun, Spoiling, joint, policy};
use crate::common::toy::{Toy, Toys};

/// N goals in [-0.9, 0.9], which the vector shows. An episode is one decision; its reward is
/// `scale` times 1 minus the distance of the action from the goal.
struct Bandit {
    scale: f32,
    goals: Vec<f32>,
    rng: ChaCha8Rng,
}

impl Bandit {
    fn envs(num_envs: usize, scale: f32) -> Toys<Self> {
        let bandit = Self { scale, goals: vec![0.0; num_envs], rng: ChaCha8Rng::seed_from_u64(1) };
        let spec = EnvSpec {
            num_envs,
            image_shape: EnvSpec::NO_IMAGE,
            vector_irreps: vec![Irrep::X],
            action_irreps: vec![Irrep::X],
            choices: vec![],
        };
        Toys::of(bandit, spec)
    }
}

impl Toy for Bandit {
    const EPISODE: usize = 1;

    fn restart(&mut self, n: usize) {
        self.goals[n] = self.rng.random_range(-0.9..0.9);
    }

    fn observe(&self, n: usize, out: &mut Observations) {
        out.vectors[n] = self.goals[n];
    }

    fn act(&mut self, n: usize, action: &[f32]) -> (f32, bool) {
        let distance = (action[0] - self.goals[n]).abs();
        (self.scale * (1.0 - distance), distance < 0.1)
    }
}

fn run(num_envs: usize, scale: f32, steps: usize) -> OnPolicyRun<Toys<Bandit>, ActorCriticPolicy> {
    let env = Bandit::envs(num_envs, scale);
    let policy = ActorCriticPolicy::new(&joint(EncoderSettings::Blind, 2), env.spec(), 2);
    OnPolicyRun::new(env, policy.unwrap(), steps)
}

/// Result of PPO after 30 rollouts of 512 decisions: success of its mean actions, and the last
/// rollout.
fn ppo(scale: f32) -> (f64, RolloutStats) {
    let mut run = run(32, scale, 16);
    let mut ppo = Ppo::new(PpoSettings::default(), &run.policy).unwrap();
    let mut last = RolloutStats::default();
    for _ in 0..30 {
        last = run.collect();
        ppo.update(&mut run.policy, &run.buffer, &mut run.rng).unwrap();
    }
    let success = evaluate_policy(&mut run.env, &mut run.policy, 16).unwrap().success_rate();
    (success.unwrap(), last)
}

#[test]
fn ppo_learns_within_the_bounds_and_is_warned_of_outside() {
    // (scale, success of mean actions, success of drawn ones): at 1e6 the mean is still learnt, but
    // exploration never shrinks
    for (scale, mean, drawn) in [
        (1.0, 0.9..=1.0, 0.8..=1.0),
        (MIN_RECOMMENDED_ABS_RETURN as f32 * 1.001, 0.9..=1.0, 0.3..=1.0),
        (MAX_RECOMMENDED_ABS_RETURN as f32 * 0.99, 0.9..=1.0, 0.3..=1.0),
        (1e-6, 0.0..=0.3, 0.0..=0.2),
        (1e6, 0.9..=1.0, 0.0..=0.25),
    ] {
        let (success, last) = ppo(scale);
        let found = (success, last.success_rate().unwrap());
        assert!(mean.contains(&found.0), "{scale:e}: {found:?}");
        assert!(drawn.contains(&found.1), "{scale:e}: {found:?}");
        let warning = last.reward_warning();
        match scale {
            1e-6 => assert!(matches!(warning, Some(RewardWarning::TooSmall { .. }))),
            1e6 => assert!(matches!(warning, Some(RewardWarning::TooLarge { .. }))),
            _ => assert_eq!(warning, None),
        }
    }
}

/// Success of mean actions and of drawn ones after 30 rollouts in a [`NormalisedEnv`].
fn ppo_on_normalised(scale: f32) -> (f64, f64) {
    let env = NormalisedEnv::new(Bandit::envs(32, scale), NormalisationSettings::default());
    let env = env.unwrap();
    let policy = ActorCriticPolicy::new(&joint(EncoderSettings::Blind, 2), env.spec(), 2);
    let mut run = OnPolicyRun::new(env, policy.unwrap(), 16);
    let mut ppo = Ppo::new(PpoSettings::default(), &run.policy).unwrap();
    let mut drawn = 0.0;
    for _ in 0..30 {
        let rollout = run.collect();
        assert_eq!(rollout.reward_warning(), None);
        drawn = rollout.success_rate().unwrap();
        ppo.update(&mut run.policy, &run.buffer, &mut run.rng).unwrap();
    }
    // statistics are saved with the policy, and evaluations change none
    let saved = serde_json::to_string(run.env.normalisation_state()).unwrap();
    let state = serde_json::from_str(&saved).unwrap();
    let restored = NormalisedEnv::new(Bandit::envs(32, scale), NormalisationSettings::default());
    let mut restored = restored.unwrap();
    restored.restore_normalisation_state(state).unwrap();
    restored.set_training(false);
    let played = evaluate_policy(&mut restored, &mut run.policy, 16).unwrap();
    assert_eq!(restored.normalisation_state(), run.env.normalisation_state());
    assert!(played.max_abs_return <= 1.1 * f64::from(scale), "rewards as they are");
    (played.success_rate().unwrap(), drawn)
}

#[test]
fn normalised_rewards_are_learnt_alike_whatever_their_scale() {
    for scale in [1.0, 1e6, 1e-6] {
        let (mean, drawn) = ppo_on_normalised(scale);
        assert!(mean > 0.9 && drawn > 0.75, "{scale:e}: {mean} {drawn}");
    }
}

#[test]
fn normalised_vectors_have_unit_variance_and_stay_symmetric_and_bad_numbers_are_seen() {
    // a trivial component that is centred, and one of X that is not
    for (irrep, mean) in [(Irrep::Trivial, 0.0), (Irrep::X, 1.0)] {
        let bandit = Bandit::envs(200, 1.0).declaring(&[irrep], &[Irrep::X]);
        let env = Spread { env: bandit, factor: 1e3, offset: 1e5 };
        let mut env = NormalisedEnv::new(env, NormalisationSettings::default()).unwrap();
        let mut first = Observations::new(env.spec());
        env.reset(&mut first).unwrap();
        let found = first.vectors.iter().sum::<f32>() / 200.0;
        let square = first.vectors.iter().map(|v| v * v).sum::<f32>() / 200.0;
        assert!((found - mean).abs() < 0.01 && (square - 1.0).abs() < 0.01, "{found} {square}");
        let other = NormalisedEnv::new(PointReach::new(1, 0), NormalisationSettings::default());
        assert!(
            other.unwrap().restore_normalisation_state(env.normalisation_state().clone()).is_err()
        );
        let mut state = serde_json::to_value(env.normalisation_state()).unwrap();
        state["observations"]["squares"][0] = (-1.0).into();
        let refused = env.restore_normalisation_state(serde_json::from_value(state).unwrap());
        assert!(refused.unwrap_err().to_string().contains("the saved `sum of squares` holds -1"));
        for (count, expected) in [(0, "0, expected at least 1"), (1, "1, expected at least 2")] {
            let mut few = serde_json::to_value(env.normalisation_state()).unwrap();
            few["observations"]["count"] = count.into();
            let restored = env.restore_normalisation_state(serde_json::from_value(few).unwrap());
            let message = restored.unwrap_err().to_string();
            assert!(message.contains(&format!("the saved `count` holds {expected}")), "{message}");
        }
        for factor in [f32::INFINITY, 1e30] {
            let large = Spread { env: Bandit::envs(2, 1.0), factor, offset: 0.0 };
            let mut wrong = NormalisedEnv::new(large, NormalisationSettings::default()).unwrap();
            let policy = ActorCriticPolicy::new(&joint(EncoderSettings::Blind, 2), wrong.spec(), 2);
            let error = RolloutState::from_env_reset(&mut wrong, &policy.unwrap()).unwrap_err();
            assert!(error.to_string().contains("environment 0, component 0, step 0"), "{error}");
        }
    }
}

/// Environments whose vectors are scaled and moved.
struct Spread<E> {
    env: E,
    factor: f32,
    offset: f32,
}

impl<E: VectorEnv> VectorEnv for Spread<E> {
    fn spec(&self) -> &EnvSpec {
        self.env.spec()
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        self.env.reset(out)?;
        out.vectors.iter_mut().for_each(|v| *v = self.factor * *v + self.offset);
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        self.env.step(actions, out)
    }
}

#[test]
fn zero_rewards_are_not_warned_of_and_messages_name_value_and_bounds_whatever_the_sign() {
    assert_eq!(run(4, 0.0, 4).collect().reward_warning(), None);
    assert_eq!(RolloutStats::default().reward_warning(), None);
    for scale in [3e38, -3e38] {
        let stats = run(4, scale, 4).collect();
        assert!(stats.max_abs_return > 1e38);
        let message = stats.reward_warning().unwrap().to_string();
        assert!(message.contains("e38 in magnitude"), "{message}");
        assert!(message.contains("between 1e-2 and 1e3"), "{message}");
    }
}

/// Returns count, not rewards: many small ones add up.
#[test]
fn long_episodes_of_small_rewards_are_not_warned_of() {
    let mut run = OnPolicyRun::new(Spoiling::new(|t| t.rewards.fill(2e-3)), policy(), 3);
    let short = run.collect().reward_warning();
    assert!(matches!(short, Some(RewardWarning::TooSmall { .. })));
    // the episodes go on, and end within the next rollout
    run.buffer = RolloutBuffer::new(run.env.spec(), 7).unwrap();
    let long = run.collect();
    assert_eq!(long.reward_warning(), None);
    assert!((long.max_abs_return - 0.02).abs() < 1e-6);
}
