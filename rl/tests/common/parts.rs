//! The arrays of one step of the toy environment, in the right sizes, and what spoils them;
//! networks and numbers of these tests.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, BoxedEnvError, CriticSettings, Decisions, EncoderSettings, EnvSpec,
    NetworkSettings, Observations, RlError, RolloutBuffer, RolloutState, StepOutcome, Transition,
    VectorEnv, collect,
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
pub struct Parts {
    pub observations: Observations,
    pub decisions: Decisions,
    pub transition: Transition,
    pub values: Vec<f32>,
}

pub fn parts() -> Parts {
    let mut transition = Transition::new(&spec());
    transition.outcomes.fill(StepOutcome::Truncated);
    Parts {
        observations: Observations::new(&spec()),
        decisions: Decisions::new(&spec()),
        transition,
        values: vec![0.0; ENVS],
    }
}

pub fn push(buffer: &mut RolloutBuffer, parts: &Parts) -> Result<(), RlError> {
    buffer.push(&parts.observations, &parts.decisions, &parts.transition, &parts.values)
}

pub fn rolled_out(env: &mut dyn VectorEnv) -> Result<(), RlError> {
    let mut policy = policy();
    let mut buffer = RolloutBuffer::new(env.spec(), 3)?;
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

/// Rows of components in natural order, each multiplied by its irrep's sign.
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

/// Random observations of the environments of `spec`.
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
