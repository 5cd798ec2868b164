//! The contract of the equivariant tanh-Gaussian policy, with and without a context.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{
    Actor, ActorMemory, ContextSettings, EncoderSettings, EnvSpec, FeatureExtractor,
    NetworkSettings, SacPolicy,
};
use symmetry::{D2, Group, Irrep};

use crate::common::parts::{
    assert_equivariant_under_only, error, random_observations, transform_vector, transformed,
};

const ENVS: usize = 3;
const A: usize = 3;

fn spec() -> EnvSpec {
    EnvSpec {
        num_envs: ENVS,
        image_shape: [16, 16, 3],
        vector_irreps: vec![Irrep::X, Irrep::Trivial, Irrep::Y],
        action_irreps: vec![Irrep::X, Irrep::Y, Irrep::Trivial],
    }
}

/// Mean actions of three steps that follow one another, and features, when all that is seen and
/// done is moved by g.
fn outputs(policy: &mut SacPolicy, g: D2) -> [Vec<f32>; 2] {
    let spec = spec();
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut memory = policy.new_memory(ENVS);
    let mut out = [vec![0.0; ENVS * A], vec![0.0; ENVS * policy.feature_dim()]];
    for _ in 0..3 {
        let seen = random_observations(&spec, &mut rng);
        let moved = transformed(&spec, &seen, g, g);
        policy.mean_actions(&moved, &mut memory, &mut out[0]).unwrap();
        policy.features(&moved, &mut out[1]).unwrap();
        for env in 0..ENVS {
            let done: Vec<f32> = (0..A).map(|_| rng.random_range(-1.0..1.0)).collect();
            let done = transform_vector(&done, &spec.action_irreps, g);
            memory.remember_step(env, &done, rng.random_range(-1.0..1.0));
        }
    }
    out
}

fn policy(group: Group, context: bool) -> SacPolicy {
    let settings = NetworkSettings {
        group,
        encoder: EncoderSettings::Strided { fields: vec![4, 8] },
        action_gain: 1.0,
        ..NetworkSettings::default()
    };
    let context = context.then_some(ContextSettings { size: 16, length: 2 });
    SacPolicy::new(&settings, context, &spec(), 5).unwrap()
}

/// Errors of means and features, relative to their sizes.
fn errors(policy: &mut SacPolicy, g: D2) -> [f32; 2] {
    let [means, features] = outputs(policy, D2::Identity);
    let moved = outputs(policy, g);
    let expected = [transform_vector(&means, &spec().action_irreps, g), features];
    [0, 1].map(|i: usize| error(&moved[i], &expected[i]))
}

#[test]
fn means_are_equivariant_and_features_invariant() {
    for group in Group::ALL {
        for context in [false, true] {
            let mut policy = policy(group, context);
            let what = format!("context: {context}");
            assert_equivariant_under_only(group, &what, |g| errors(&mut policy, g));
        }
    }
}
