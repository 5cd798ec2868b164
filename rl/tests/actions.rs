//! Actions that no environment can execute are rejected by name before they reach it.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    Actor, EnvSpec, ExperienceBuffer, Observations, RlError, RolloutState, Transition,
    collect_experience, evaluate_policy,
};

use crate::common::actors::{Ages, BlindActor};

const ENVS: usize = 3;

/// Does the same everywhere.
fn constant(action: f32) -> impl Actor<Memory = ()> {
    BlindActor { new_memory: |_| (), decide: move |(): &mut (), out: &mut [f32]| out.fill(action) }
}

/// Keeps nothing, and lets the actor write into an array of any length.
struct Sieve {
    steps: usize,
    actions: Vec<f32>,
}

impl<A: Actor> ExperienceBuffer<A> for Sieve {
    fn steps_per_env(&self) -> usize {
        self.steps
    }

    fn begin(&mut self, _: &EnvSpec) -> Result<(), RlError> {
        Ok(())
    }

    fn action_buffer(&mut self) -> (&mut [f32], bool) {
        (&mut self.actions, false)
    }

    fn record(&mut self, _: &mut A, _: &Observations, _: &Transition) -> Result<(), RlError> {
        Ok(())
    }
}

fn env() -> Ages {
    Ages::new(&[3; ENVS])
}

/// Collects with `len` numbers `action` at every step.
fn collected(steps: usize, action: f32, len: usize) -> Result<usize, RlError> {
    let (mut env, mut actor) = (env(), constant(action));
    let mut sieve = Sieve { steps, actions: vec![0.0; len] };
    let mut state = RolloutState::from_env_reset(&mut env, &actor)?;
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    Ok(collect_experience(&mut env, &mut actor, &mut sieve, &mut state, &mut rng)?.decisions)
}

#[test]
fn only_finite_actions_reach_the_environments() {
    assert_eq!(collected(4, 0.5, ENVS).unwrap(), 4 * ENVS);
    let stats = evaluate_policy(&mut env(), &mut constant(0.5), 1).unwrap();
    assert_eq!(stats.episodes.len(), ENVS);
    for action in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let evaluated = evaluate_policy(&mut env(), &mut constant(action), 1).map(|_| ());
        for result in [collected(4, action, ENVS).map(|_| ()), evaluated] {
            let named =
                matches!(result, Err(RlError::NotFinite { what, .. }) if what == "an action");
            assert!(named, "{result:?}");
        }
    }
}

#[test]
fn too_few_and_too_many_actions_and_no_steps_are_refused() {
    for len in [0, ENVS - 1, ENVS + 1] {
        let result = collected(4, 0.5, len);
        let named = matches!(
            result,
            Err(RlError::ShapeMismatch { what: "actions", got, expected: ENVS, .. }) if got == len
        );
        assert!(named, "{result:?}");
    }
    let result = collected(0, 0.5, ENVS);
    let named = matches!(result, Err(RlError::InvalidSetting { name: "steps", .. }));
    assert!(named, "{result:?}");
}
