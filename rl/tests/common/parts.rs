//! The arrays of one step of the toy environment, in the right sizes, and what spoils them.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, BoxError, Decisions, Encoder, EnvSpec, NetworkSettings, Observations,
    Outcome, RlError, RolloutBuffer, RolloutState, Transition, VectorEnv, collect,
};

use crate::common::PointReach;

pub const ENVS: usize = 3;

pub fn spec() -> EnvSpec {
    PointReach::new(ENVS, 0).spec().clone()
}

pub fn policy() -> ActorCriticPolicy {
    let settings = NetworkSettings {
        encoder: Encoder::Strided { fields: vec![2] },
        top_fields: 2,
        vector_fields: 2,
        actor_fields: 2,
        ..NetworkSettings::default()
    };
    ActorCriticPolicy::new(&settings, &spec(), 1).unwrap()
}

/// What every step of a rollout takes, in the right sizes.
#[derive(Clone)]
pub struct Parts {
    pub observations: Observations,
    pub decisions: Decisions,
    pub transition: Transition,
    pub values: Vec<f32>,
}

pub fn parts() -> Parts {
    let mut transition = Transition::new(&spec());
    transition.outcomes.fill(Outcome::Truncated);
    Parts {
        observations: Observations::new(&spec()),
        decisions: Decisions::new(&spec()),
        transition,
        values: vec![0.0; ENVS],
    }
}

pub fn push(buffer: &mut RolloutBuffer, parts: &Parts) -> Result<(), RlError> {
    buffer.push(
        &parts.observations,
        &parts.decisions,
        &parts.transition,
        &parts.values,
    )
}

pub fn rolled_out(env: &mut dyn VectorEnv) -> Result<(), RlError> {
    let mut policy = policy();
    let mut buffer = RolloutBuffer::new(env.spec(), 2)?;
    let mut state = RolloutState::reset(env, &policy)?;
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    collect(env, &mut policy, &mut buffer, &mut state, &mut rng).map(|_| ())
}

/// An environment whose transitions are changed before they are handed out.
pub struct Spoiling<F> {
    env: PointReach,
    spoil: F,
}

impl<F: FnMut(&mut Transition)> Spoiling<F> {
    pub fn new(spoil: F) -> Self {
        Self {
            env: PointReach::new(ENVS, 0),
            spoil,
        }
    }
}

impl<F: FnMut(&mut Transition)> VectorEnv for Spoiling<F> {
    fn spec(&self) -> &EnvSpec {
        self.env.spec()
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxError> {
        self.env.reset(out)
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxError> {
        self.env.step(actions, out)?;
        (self.spoil)(out);
        Ok(())
    }
}
