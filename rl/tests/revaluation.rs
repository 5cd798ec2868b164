//! Training on the rollout of another policy, or on an augmented one: the policy's own
//! log-probabilities and values replace the recorded ones.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    Actor, ActorCriticPolicy, Algorithm, Decisions, EncoderSettings, EvaluateActions,
    NetworkSettings, Observations, Ppo, PpoSettings, PpoStats, RlError, RolloutBuffer, Transition,
    ValueFunction, VectorEnv,
};

use crate::common::steps::{OnPolicyRun, largest};
use crate::common::{EPISODE, PointReach};

const ENVS: usize = 5;

fn policy(seed: u64) -> ActorCriticPolicy {
    let settings = NetworkSettings {
        encoder: EncoderSettings::Strided { fields: vec![4] },
        action_gain: 1.0,
        ..NetworkSettings::default()
    };
    ActorCriticPolicy::new(&settings, PointReach::new(ENVS, 0).spec(), seed).unwrap()
}

/// Episodes end in the middle, and run on at the end.
const STEPS: usize = 2 * EPISODE + 3;

/// A rollout from the first step of the same environments on.
fn rollout(policy: &ActorCriticPolicy) -> RolloutBuffer {
    let mut run = OnPolicyRun::new(PointReach::new(ENVS, 1), policy.clone(), STEPS);
    run.collect();
    run.buffer
}

/// The slow twin: acts as one policy and says at every step what another one thinks of it.
fn commented(actor: &mut ActorCriticPolicy, critic: &mut ActorCriticPolicy) -> RolloutBuffer {
    let mut env = PointReach::new(ENVS, 1);
    let spec = env.spec().clone();
    let mut buffer = RolloutBuffer::new(&spec, STEPS).unwrap();
    let (mut now, mut next) = (Observations::new(&spec), Transition::new(&spec));
    let (mut decisions, mut values) = (Decisions::new(&spec), [0.0; ENVS]);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    env.reset(&mut now).unwrap();
    for _ in 0..STEPS {
        actor.act(&now, &mut (), &mut rng, &mut decisions.actions).unwrap();
        critic.evaluate_actions(&now, &mut decisions).unwrap();
        env.step(&decisions.actions, &mut next).unwrap();
        critic.values(&next.final_observations, &mut values).unwrap();
        buffer.push(&now, &decisions, &next, &values).unwrap();
        now.clone_from(&next.observations);
    }
    critic.values(&now, &mut values).unwrap();
    buffer.finish(&now, &values).unwrap();
    buffer
}

/// Log-probabilities, values, advantages and returns.
fn figures(buffer: &RolloutBuffer) -> [Vec<f32>; 4] {
    let (mut advantages, mut returns) =
        (vec![0.0; buffer.num_samples()], vec![0.0; buffer.num_samples()]);
    buffer.write_advantages_and_returns(0.9, 0.8, &mut advantages, &mut returns).unwrap();
    let Decisions { log_probs, values, .. } = buffer.decisions().clone();
    [log_probs, values, advantages, returns]
}

fn largest_difference(one: &RolloutBuffer, other: &RolloutBuffer) -> f32 {
    let pairs = figures(one).into_iter().zip(figures(other));
    let pairs = pairs.flat_map(|(a, b)| a.into_iter().zip(b));
    largest(pairs.map(|(a, b)| (a - b).abs()))
}

#[test]
fn another_policys_rollout_is_valued_as_if_it_had_been_commented_at_every_step() {
    let (mut actor, mut critic) = (policy(2), policy(7));
    let expected = commented(&mut actor, &mut critic);
    let mut buffer = rollout(&actor);
    assert!(largest_difference(&buffer, &expected) > 0.1);
    buffer.reevaluate(&mut critic).unwrap();
    assert!(largest_difference(&buffer, &expected) < 1e-5);
    assert_eq!(buffer.decisions().actions, expected.decisions().actions);
    // and back
    buffer.reevaluate(&mut actor).unwrap();
    assert!(largest_difference(&buffer, &rollout(&actor)) < 1e-5);
}

/// An update with steps of size almost zero.
fn still_update(policy: &mut ActorCriticPolicy, buffer: &RolloutBuffer) -> PpoStats {
    let settings = PpoSettings {
        head_learning_rate: 1e-30,
        encoder_learning_rate: 1e-30,
        max_kl: 1e9,
        ..PpoSettings::default()
    };
    let mut ppo = Ppo::new(settings, policy).unwrap();
    ppo.update(policy, buffer, &mut ChaCha8Rng::seed_from_u64(4)).unwrap()
}

#[test]
fn the_ratio_starts_at_one_only_after_revaluation() {
    let mut buffer = rollout(&policy(2));
    let mut heir = policy(7);
    assert!(still_update(&mut heir, &buffer).clip_fraction > 0.1);
    buffer.reevaluate(&mut heir).unwrap();
    let stats = still_update(&mut heir, &buffer);
    assert!(stats.approx_kl.abs() < 1e-9, "{stats:?}");
    assert_eq!(stats.clip_fraction, 0.0);
}

#[test]
fn a_buffer_that_is_filled_anew_forgets_its_final_observations() {
    let (mut actor, mut critic) = (policy(2), policy(7));
    let mut anew = OnPolicyRun::new(PointReach::new(ENVS, 1), actor.clone(), STEPS);
    anew.buffer = rollout(&policy(3));
    anew.collect();
    anew.buffer.reevaluate(&mut critic).unwrap();
    let expected = commented(&mut actor, &mut critic);
    assert!(largest_difference(&anew.buffer, &expected) < 1e-5);
}

#[test]
fn an_unfinished_rollout_is_refused() {
    let mut buffer = rollout(&policy(2));
    buffer.clear();
    assert!(matches!(
        buffer.reevaluate(&mut policy(2)),
        Err(RlError::BufferNotFinished { got: 0, .. })
    ));
}

/// A policy that spoils one of its outputs: 0 is the evaluation of actions, 1 the values of final
/// observations, 2 those of the last ones.
struct Faulty {
    policy: ActorCriticPolicy,
    answers: usize,
    spoilt: usize,
    fails: bool,
}

fn mismatch() -> RlError {
    RlError::SpecMismatch { field: "image_shape", one: "[8, 8, 3]".into(), two: "[6, 6, 3]".into() }
}

impl Faulty {
    fn answer(&mut self, out: &mut [f32]) -> Result<(), RlError> {
        self.answers += 1;
        match (self.answers == self.spoilt + 1, self.fails) {
            (true, true) => Err(mismatch()),
            (true, false) => {
                out[1] = f32::NAN;
                Ok(())
            }
            (false, _) => Ok(()),
        }
    }
}

impl ValueFunction for Faulty {
    fn values(&mut self, observations: &Observations, out: &mut [f32]) -> Result<(), RlError> {
        self.policy.values(observations, out)?;
        self.answer(out)
    }
}

impl EvaluateActions for Faulty {
    fn evaluate_actions(
        &mut self,
        observations: &Observations,
        decisions: &mut Decisions,
    ) -> Result<(), RlError> {
        self.policy.evaluate_actions(observations, decisions)?;
        self.answer(&mut decisions.log_probs)
    }
}

#[test]
fn a_revaluation_that_fails_changes_nothing() {
    let mut buffer = rollout(&policy(2));
    let before = figures(&buffer);
    for spoilt in 0..3 {
        for fails in [true, false] {
            let mut faulty = Faulty { policy: policy(7), answers: 0, spoilt, fails };
            let result = buffer.reevaluate(&mut faulty);
            assert_eq!(faulty.answers, spoilt + 1);
            assert!(result.is_err(), "answer {spoilt}");
            assert!(figures(&buffer) == before, "answer {spoilt}");
        }
    }
}
