//! Collection: success, errors and noise, and rollouts that are shorter than an episode.

use rl::{
    ActorCriticPolicy, BoxedEnvError, EncoderSettings, EnvSpec, ExperienceBuffer, NetworkSettings,
    Observations, RlError, RolloutBuffer, RolloutState, StepOutcome, Transition, VectorEnv,
    evaluate_policy,
};
use symmetry::Irrep;

use crate::common::actors::Ages;
use crate::common::steps::OnPolicyRun;
use crate::common::{EPISODE, PointReach};

/// Two environments with episodes of three steps. Success holds within the last step of both, but
/// at its end in the second alone.
struct Scripted {
    spec: EnvSpec,
    time: usize,
    fails: bool,
}

impl Scripted {
    fn new() -> Self {
        let spec = EnvSpec {
            num_envs: 2,
            image_shape: [4, 4, 1],
            vector_irreps: vec![Irrep::X],
            action_irreps: vec![Irrep::X],
            choices: vec![],
        };
        Self { spec, time: 0, fails: false }
    }
}

#[derive(Debug, thiserror::Error)]
#[error("the table fell over")]
struct FellOver;

impl VectorEnv for Scripted {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, _: &mut Observations) -> Result<(), BoxedEnvError> {
        self.time = 0;
        Ok(())
    }

    fn step(&mut self, _: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        if self.fails {
            return Err(FellOver.into());
        }
        self.time = self.time % 3 + 1;
        out.success = vec![self.time == 3; 2];
        out.success_at_end = vec![false, self.time == 3];
        out.outcomes.fill(match self.time {
            3 => StepOutcome::Terminated,
            _ => StepOutcome::Running,
        });
        Ok(())
    }
}

fn policy(spec: &EnvSpec, encoder: EncoderSettings) -> ActorCriticPolicy {
    let settings = NetworkSettings { encoder, ..NetworkSettings::default() };
    ActorCriticPolicy::new(&settings, spec, 1).unwrap()
}

fn strided(spec: &EnvSpec) -> ActorCriticPolicy {
    policy(spec, EncoderSettings::Strided { fields: vec![2] })
}

#[test]
fn success_at_the_end_is_that_of_the_last_state() {
    let mut policy = strided(Scripted::new().spec());
    let evaluated = evaluate_policy(&mut Scripted::new(), &mut policy, 2).unwrap();
    for each in [OnPolicyRun::new(Scripted::new(), policy, 3).collect(), evaluated] {
        assert_eq!(each.success_rate(), Some(1.0));
        assert_eq!(each.success_at_end_rate(), Some(0.5));
        assert!(each.episodes.iter().all(|e| e.success_at_end == (e.env == 1)));
    }
}

#[test]
fn the_error_of_an_environment_is_handed_on() {
    let mut env = Scripted::new();
    env.fails = true;
    let mut policy = strided(&env.spec);
    let error = evaluate_policy(&mut env, &mut policy, 1).unwrap_err();
    assert!(matches!(&error, RlError::Environment(inner) if inner.is::<FellOver>()));
    assert_eq!(error.to_string(), "the environment failed: the table fell over");
}

/// A policy whose actions are the noise: all of its parameters are 0, also log_std.
fn echo(spec: &EnvSpec) -> ActorCriticPolicy {
    let mut policy = policy(spec, EncoderSettings::Blind);
    policy.params_mut().fill(0.0);
    policy
}

/// The noise `[T, N]` of two rollouts of five steps, one after the other, in environments with
/// episodes of three and of four steps.
fn noise(correlation: f32) -> Vec<f32> {
    let env = Ages::new(&[3, 4]);
    let policy = echo(env.spec());
    let mut run = OnPolicyRun::new(env, policy, 5);
    run.buffer = run.buffer.with_noise_correlation(correlation).unwrap();
    let mut out = Vec::new();
    for _ in 0..2 {
        run.collect();
        out.extend_from_slice(&run.buffer.decisions().actions);
    }
    out
}

/// Correlated noise starts again with every episode, after either kind of end, and with every
/// rollout.
#[test]
fn the_noise_of_an_episode_goes_on_and_that_of_the_next_begins_afresh() {
    let (fresh, kept) = (noise(0.0), noise(0.6));
    let begins: [&[usize]; 2] = [&[0, 3, 5, 6, 9], &[0, 4, 5, 8]];
    let mut expected = [0.0; 2];
    for t in 0..10 {
        for n in 0..2 {
            let (fresh, kept) = (fresh[2 * t + n], kept[2 * t + n]);
            let begun = begins[n].contains(&t);
            expected[n] = if begun { fresh } else { 0.6 * expected[n] + 0.8 * fresh };
            assert!((kept - expected[n]).abs() < 1e-5, "{n} at {t}: {kept}");
        }
    }
}

#[test]
fn outcomes_of_other_environments_are_refused() {
    let env = Ages::new(&[3, 4]);
    let mut buffer = RolloutBuffer::new(env.spec(), 5).unwrap();
    let from = Observations::new(env.spec());
    let mut to = Transition::new(env.spec());
    to.outcomes = vec![StepOutcome::Terminated; 3];
    let error = buffer.record(&mut echo(env.spec()), &from, &to).unwrap_err();
    assert!(matches!(error, RlError::ShapeMismatch { .. }), "{error}");
}

#[test]
fn a_rollout_shorter_than_an_episode_is_refused_with_both_numbers() {
    let env = PointReach::new(2, 0);
    let horizon = env.horizon().unwrap();
    let buffer = |steps| RolloutBuffer::new(env.spec(), steps).unwrap();
    assert!(buffer(EPISODE).check_horizon(horizon).is_ok());
    let error = buffer(EPISODE - 1).check_horizon(horizon).unwrap_err();
    assert!(matches!(error, RlError::ShortRollout { steps: 9, horizon: 10 }));
    let message = error.to_string();
    assert!(
        message.starts_with("rollouts of 9 steps end before an episode of 10 steps does"),
        "{message}"
    );
    assert_eq!(Ages::new(&[3, 7, 5]).horizon(), Some(7));
}

/// Rollouts of 4 steps, where an episode has 10.
fn short() -> OnPolicyRun<PointReach, ActorCriticPolicy> {
    let env = PointReach::new(2, 0);
    let policy = strided(env.spec());
    OnPolicyRun::new(env, policy, 4)
}

/// Returns that three rollouts report returns, and whether a late state was met.
fn short_rollouts(reset: bool) -> [bool; 2] {
    let mut run = short();
    let (mut returns, mut late) = (false, false);
    for _ in 0..3 {
        if reset {
            run.state = RolloutState::from_env_reset(&mut run.env, &run.policy).unwrap();
        }
        returns |= run.collect().mean_return().is_some();
        late |= run.state.episodes.iter().any(|e| e.length > 4) || returns;
    }
    [returns, late]
}

/// The reason for `check_horizon`, as documented at `collect_experience`.
#[test]
fn short_rollouts_meet_late_states_only_where_episodes_go_on() {
    assert_eq!(short_rollouts(true), [false, false]);
    assert_eq!(short_rollouts(false), [true, true]);
}

/// The situation after a truncated rollout was used for an update.
#[test]
fn after_a_rollout_that_lost_its_end_the_next_is_whole() {
    let mut run = short();
    for _ in 0..2 {
        let stats = run.collect();
        assert_eq!((stats.decisions, run.buffer.steps_per_env()), (8, 4));
        run.buffer.truncate(3).unwrap();
        assert_eq!(run.buffer.steps_per_env(), 3);
    }
}
