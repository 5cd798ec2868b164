//! Reward scales other than 1: the range in which PPO trains, and the warning outside of it.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Algorithm, EncoderSettings, EnvSpec, MAX_ABS_RETURN, MIN_ABS_RETURN,
    Observations, Ppo, PpoSettings, RewardWarning, RolloutBuffer, RolloutStats, VectorEnv,
    evaluate,
};
use symmetry::Irrep;

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
    let success = evaluate(&mut run.env, &mut run.policy, 16).unwrap().success_rate();
    (success.unwrap(), last)
}

#[test]
fn ppo_learns_within_the_bounds_and_is_warned_of_outside() {
    // (scale, success of mean actions, success of drawn ones): at 1e6 the mean is still learnt, but
    // exploration never shrinks
    for (scale, mean, drawn) in [
        (1.0, 0.9..=1.0, 0.8..=1.0),
        (MIN_ABS_RETURN as f32 * 1.001, 0.9..=1.0, 0.3..=1.0),
        (MAX_ABS_RETURN as f32 * 0.99, 0.9..=1.0, 0.3..=1.0),
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
