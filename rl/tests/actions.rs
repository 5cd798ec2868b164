//! Actions that no environment can execute are rejected by name before they reach it.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{EnvSpec, Experience, Observations, RlError, RolloutState, Transition, collect, evaluate};

use crate::common::unseeing::{Acting, Ages, Unseeing};

const ENVS: usize = 3;

/// Does the same everywhere.
struct Constant(f32);

fn constant(action: f32) -> Acting<Constant> {
    Acting(Constant(action))
}

impl Unseeing for Constant {
    type Memory = ();

    fn new_memory(&self, _: usize) {}

    fn decide(&self, (): &mut (), out: &mut [f32]) {
        out.fill(self.0);
    }
}

/// Keeps nothing, and hands out the same actions at every step.
struct Sieve {
    steps: usize,
    actions: Vec<f32>,
}

impl Experience<Acting<Constant>> for Sieve {
    fn steps_per_env(&self) -> usize {
        self.steps
    }

    fn begin(&mut self, _: &EnvSpec) -> Result<(), RlError> {
        Ok(())
    }

    fn action_buffer(&mut self) -> (&mut [f32], bool) {
        (&mut self.actions, false)
    }

    fn decide(
        &mut self,
        _: &mut Acting<Constant>,
        _: &Observations,
        (): &mut (),
        _: &mut ChaCha8Rng,
    ) -> Result<&[f32], RlError> {
        Ok(&self.actions)
    }

    fn record(
        &mut self,
        _: &mut Acting<Constant>,
        _: &Observations,
        _: &Transition,
    ) -> Result<(), RlError> {
        Ok(())
    }
}

fn env() -> Ages {
    Ages::new(&[3; ENVS])
}

/// Collects with these actions at every step.
fn collected(steps: usize, actions: &[f32]) -> Result<usize, RlError> {
    let (mut env, mut actor) = (env(), constant(0.0));
    let mut sieve = Sieve { steps, actions: actions.to_vec() };
    let mut state = RolloutState::reset(&mut env, &actor)?;
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    Ok(collect(&mut env, &mut actor, &mut sieve, &mut state, &mut rng)?.decisions)
}

#[test]
fn finite_actions_in_every_environment_are_executed() {
    assert_eq!(collected(4, &[0.5; ENVS]).unwrap(), 4 * ENVS);
    let stats = evaluate(&mut env(), &mut constant(0.5), 1).unwrap();
    assert_eq!(stats.episodes.len(), ENVS);
}

#[test]
fn actions_that_are_not_numbers_never_reach_the_environment() {
    for action in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let results = [
            collected(4, &[action; ENVS]).map(|_| ()),
            evaluate(&mut env(), &mut constant(action), 1).map(|_| ()),
        ];
        for result in results {
            let named =
                matches!(result, Err(RlError::NotFinite { what, .. }) if what == "an action");
            assert!(named, "{result:?}");
        }
    }
}

#[test]
fn too_few_and_too_many_actions_never_reach_the_environment() {
    for len in [0, ENVS - 1, ENVS + 1] {
        let result = collected(4, &vec![0.5; len]);
        let named = matches!(
            result,
            Err(RlError::ShapeMismatch { what: "actions", got, expected: ENVS, .. }) if got == len
        );
        assert!(named, "{result:?}");
    }
}

#[test]
fn a_collection_of_no_steps_is_refused() {
    let result = collected(0, &[0.5; ENVS]);
    let named = matches!(result, Err(RlError::InvalidSetting { name: "steps", .. }));
    assert!(named, "{result:?}");
}
