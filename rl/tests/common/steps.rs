//! The arrays of one step of the toy environment, in the right sizes, and what spoils them;
//! rollouts, networks and comparisons of these tests.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{
    Actor, ActorCriticPolicy, ActorMemory, BoxedEnvError, CriticSettings, Decisions,
    EncoderSettings, EnvSpec, FeatureExtractor, NetworkSettings, Observations, OnPolicyActor,
    RlError, RolloutBuffer, RolloutState, RolloutStats, StepOutcome, Transition, VectorEnv,
    collect_experience,
};
use symmetry::{D2, Group, Irrep};

use crate::common::PointReach;

pub const ENVS: usize = 3;

pub fn spec() -> EnvSpec {
    PointReach::new(ENVS, 0).spec().clone()
}

pub fn policy() -> ActorCriticPolicy {
    let settings = NetworkSettings {
        encoder: EncoderSettings::Strided { fields: vec![2] },
        top_fields: 2,
        vector_fields: 2,
        actor_fields: 2,
        ..NetworkSettings::default()
    };
    ActorCriticPolicy::new(&settings, &spec(), 1).unwrap()
}

/// Arguments of a push of one step, in the right sizes.
#[derive(Clone)]
pub struct StepArrays {
    pub observations: Observations,
    pub decisions: Decisions,
    pub transition: Transition,
    pub values: Vec<f32>,
}

pub fn step_arrays() -> StepArrays {
    let mut transition = Transition::new(&spec());
    transition.outcomes.fill(StepOutcome::Truncated);
    StepArrays {
        observations: Observations::new(&spec()),
        decisions: Decisions::new(&spec()),
        transition,
        values: vec![0.0; ENVS],
    }
}

pub fn push(buffer: &mut RolloutBuffer, arrays: &StepArrays) -> Result<(), RlError> {
    buffer.push(&arrays.observations, &arrays.decisions, &arrays.transition, &arrays.values)
}

/// An actor in environments, in the middle of their episodes, with a buffer for its rollouts.
pub struct OnPolicyRun<E, P: OnPolicyActor> {
    pub env: E,
    pub policy: P,
    pub buffer: RolloutBuffer,
    pub state: RolloutState<P::Memory>,
    pub rng: ChaCha8Rng,
}

impl<E: VectorEnv, P: OnPolicyActor> OnPolicyRun<E, P> {
    pub fn new(mut env: E, policy: P, steps: usize) -> Self {
        Self {
            buffer: RolloutBuffer::new(env.spec(), steps).unwrap(),
            state: RolloutState::from_env_reset(&mut env, &policy).unwrap(),
            rng: ChaCha8Rng::seed_from_u64(3),
            env,
            policy,
        }
    }

    pub fn try_collect(&mut self) -> Result<RolloutStats, RlError> {
        collect_experience(
            &mut self.env,
            &mut self.policy,
            &mut self.buffer,
            &mut self.state,
            &mut self.rng,
        )
    }

    pub fn collect(&mut self) -> RolloutStats {
        self.try_collect().unwrap()
    }
}

/// Collects a rollout of three steps with the small policy.
pub fn rolled_out(env: impl VectorEnv) -> Result<(), RlError> {
    OnPolicyRun::new(env, policy(), 3).try_collect().map(|_| ())
}

/// An environment whose transitions are changed before they are handed out.
pub struct Spoiling<F> {
    env: PointReach,
    spoil: F,
}

impl<F: FnMut(&mut Transition)> Spoiling<F> {
    pub fn new(spoil: F) -> Self {
        Self { env: PointReach::new(ENVS, 0), spoil }
    }
}

impl<F: FnMut(&mut Transition)> VectorEnv for Spoiling<F> {
    fn spec(&self) -> &EnvSpec {
        self.env.spec()
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        self.env.reset(out)
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        self.env.step(actions, out)?;
        (self.spoil)(out);
        Ok(())
    }
}

/// All parts have this many fields.
pub fn joint(encoder: EncoderSettings, fields: usize) -> NetworkSettings {
    NetworkSettings {
        encoder,
        top_fields: fields,
        vector_fields: fields,
        actor_fields: fields,
        critic: CriticSettings::Joint { fields },
        ..NetworkSettings::default()
    }
}

/// The largest of `numbers`, at least 0, and NaN as soon as one is: `f32::max` would drop it, and a
/// check against a tolerance would pass.
pub fn largest(numbers: impl IntoIterator<Item = f32>) -> f32 {
    let larger = |most: f32, x: f32| if most.is_nan() || x <= most { most } else { x };
    numbers.into_iter().fold(0.0, larger)
}

#[test]
fn a_nan_is_the_largest_number() {
    assert_eq!(largest([0.5, 2.0, 1.0]), 2.0);
    for at in 0..3 {
        let mut numbers = [0.5, 2.0, 1.0];
        numbers[at] = f32::NAN;
        assert!(largest(numbers).is_nan(), "{at}");
    }
}

/// Rows of components in the environment's order, each multiplied by its irrep's sign.
pub fn transform_vector(rows: &[f32], irreps: &[Irrep], g: D2) -> Vec<f32> {
    let signs = irreps.iter().cycle().map(|irrep| f32::from(irrep.sign(g)));
    rows.iter().zip(signs).map(|(x, s)| x * s).collect()
}

/// Observations with pixels moved by `pixels` and vectors changed by `vectors`: the group action
/// when both agree.
pub fn transformed(spec: &EnvSpec, from: &Observations, pixels: D2, vectors: D2) -> Observations {
    let [h, w, c] = spec.image_shape;
    let images = from.images.chunks((h * w * c).max(1));
    Observations {
        images: images.flat_map(|image| pixels.transform_image(image, h, w, c)).collect(),
        vectors: transform_vector(&from.vectors, &spec.vector_irreps, vectors),
    }
}

pub fn random_observations(spec: &EnvSpec, rng: &mut ChaCha8Rng) -> Observations {
    let mut out = Observations::new(spec);
    out.images.fill_with(|| rng.random());
    out.vectors.fill_with(|| rng.random_range(-1.0..1.0));
    out
}

/// Largest difference relative to the largest entry.
pub fn error(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    let size = largest(b.iter().map(|x| x.abs()));
    assert!(size > 0.0, "an output that is all zero proves nothing");
    largest(a.iter().zip(b).map(|(x, y)| (x - y).abs())) / size
}

/// Largest relative error that is rounding.
pub const TOLERANCE: f32 = 1e-5;

/// Errors of mean actions and features after three steps that follow one another, when all that is
/// seen and done is moved by g.
pub fn equivariance_errors<P: Actor + FeatureExtractor>(
    policy: &mut P,
    spec: &EnvSpec,
    g: D2,
) -> [f32; 2] {
    let (n, width) = (spec.num_envs, spec.action_irreps.len());
    let mut outputs = |by: D2| {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let mut memory = policy.new_memory(n);
        let mut out = [vec![0.0; n * width], vec![0.0; n * policy.feature_dim()]];
        for _ in 0..3 {
            let moved = transformed(spec, &random_observations(spec, &mut rng), by, by);
            policy.mean_actions(&moved, &mut memory, &mut out[0]).unwrap();
            policy.features(&moved, &mut out[1]).unwrap();
            for env in 0..n {
                let action: Vec<f32> = (0..width).map(|_| rng.random_range(-1.0..1.0)).collect();
                let action = transform_vector(&action, &spec.action_irreps, by);
                memory.remember_step(env, &action, rng.random_range(-1.0..1.0));
            }
        }
        out
    };
    let ([means, features], moved) = (outputs(D2::Identity), outputs(g));
    let means = transform_vector(&means, &spec.action_irreps, g);
    [error(&moved[0], &means), error(&moved[1], &features)]
}

/// Checks that `errors` under an element of D2 are rounding for those of `group` and far above it
/// for all others, so that no output is equivariant by accident.
pub fn assert_equivariant_under_only<const N: usize>(
    group: Group,
    what: &str,
    mut errors: impl FnMut(D2) -> [f32; N],
) {
    for g in D2::ALL {
        let errors = errors(g);
        let right = |&error: &f32| {
            if group.contains(g) { error < TOLERANCE } else { error > 100.0 * TOLERANCE }
        };
        assert!(errors.iter().all(right), "{what}, {group}, {g}: {errors:?}");
    }
}
