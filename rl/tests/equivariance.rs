//! The contract of the equivariant policies, for every group and every kind of encoder, with and
//! without a context.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    Actor, ActorCriticPolicy, CriticSettings, EncoderSettings, EnvSpec, FeatureExtractor,
    NetworkSettings, Observations, RecurrentContextSettings, SacPolicy, ValueFunction,
};
use symmetry::{D2, Group, Irrep};

use crate::common::steps::{
    TOLERANCE, assert_equivariant_under_only, equivariance_errors, error, random_observations,
    transform_vector, transformed,
};

const SAMPLES: usize = 6;

/// Components in an order that is not irrep-major, so that the reordering is tested, too.
fn spec() -> EnvSpec {
    let vector =
        vec![Irrep::X, Irrep::Y, Irrep::Trivial, Irrep::Trivial, Irrep::XY, Irrep::X, Irrep::Y];
    EnvSpec {
        num_envs: SAMPLES,
        image_shape: [32, 32, 6],
        action_irreps: vector[..5].to_vec(),
        choices: vec![],
        vector_irreps: vector,
    }
}

/// The two kinds of encoder and the two of critic, for pictures of 32 x 32 pixels.
fn networks() -> [NetworkSettings; 3] {
    let pooled = NetworkSettings {
        encoder: EncoderSettings::Pooled { fields: vec![4, 8], inner: [16, 8] },
        ..NetworkSettings::default()
    };
    [NetworkSettings::default(), pooled, with_pooled_critic()]
}

fn with_pooled_critic() -> NetworkSettings {
    NetworkSettings { critic: CriticSettings::Pooled { width: 64 }, ..NetworkSettings::default() }
}

/// A random policy whose mean actions are of order one.
fn policy_of(settings: &NetworkSettings) -> ActorCriticPolicy {
    let settings = NetworkSettings { action_gain: 1.0, ..settings.clone() };
    ActorCriticPolicy::new(&settings, &spec(), 5).unwrap()
}

fn policy() -> ActorCriticPolicy {
    policy_of(&NetworkSettings::default())
}

fn observations() -> Observations {
    random_observations(&spec(), &mut ChaCha8Rng::seed_from_u64(11))
}

/// Mean actions, values and features.
fn outputs(policy: &mut ActorCriticPolicy, observations: &Observations) -> [Vec<f32>; 3] {
    let mut out = [5, 1, policy.feature_dim()].map(|width| vec![0.0; SAMPLES * width]);
    policy.mean_actions(observations, &mut (), &mut out[0]).unwrap();
    policy.values(observations, &mut out[1]).unwrap();
    policy.features(observations, &mut out[2]).unwrap();
    out
}

/// Errors of mean, value and features when the input is changed by (`pixels`, `vectors`) and the
/// mean by `action`.
fn errors(pixels: D2, vectors: D2, action: D2) -> [f32; 3] {
    errors_of(&mut policy(), pixels, vectors, action)
}

fn errors_of(policy: &mut ActorCriticPolicy, pixels: D2, vectors: D2, action: D2) -> [f32; 3] {
    let [mean, value, features] = outputs(policy, &observations());
    let moved = outputs(policy, &transformed(&spec(), &observations(), pixels, vectors));
    let mean = transform_vector(&mean, &spec().action_irreps, action);
    [error(&moved[0], &mean), error(&moved[1], &value), error(&moved[2], &features)]
}

#[test]
fn mean_is_equivariant_and_value_and_features_are_invariant() {
    for settings in networks() {
        for group in Group::ALL {
            let mut policy = policy_of(&NetworkSettings { group, ..settings.clone() });
            let errors = |g| errors_of(&mut policy, g, g, g);
            assert_equivariant_under_only(group, &format!("{settings:?}"), errors);
        }
    }
}

#[test]
fn the_check_of_the_mean_fails_for_a_wrong_group_action() {
    for g in [D2::FlipX, D2::FlipY, D2::HalfTurn] {
        for wrong in D2::ALL.into_iter().filter(|&wrong| wrong != g) {
            let [images, vectors, action] =
                [errors(wrong, g, g)[0], errors(g, wrong, g)[0], errors(g, g, wrong)[0]];
            assert!(images > 100.0 * TOLERANCE, "images {wrong} for {g}: {images}");
            assert!(vectors > 100.0 * TOLERANCE, "vectors {wrong} for {g}: {vectors}");
            assert!(action > 100.0 * TOLERANCE, "action {wrong} for {g}: {action}");
        }
    }
}

/// Pooling comes right after the concatenation, so features, and the values of the paper's critic,
/// do not notice a symmetry of one input alone: where the vector's hand is relative to the image's
/// object. The joint critic does.
#[test]
fn only_the_joint_critic_sees_how_the_vector_lies_relative_to_the_image() {
    for g in [D2::FlipX, D2::FlipY, D2::HalfTurn] {
        let of = |settings| errors_of(&mut policy_of(&settings), D2::Identity, g, g);
        let [_, papers, features] = of(with_pooled_critic());
        assert!(papers < TOLERANCE && features < TOLERANCE, "{g}");
        let [_, joint, joint_features] = of(NetworkSettings::default());
        assert!(joint > 100.0 * TOLERANCE && joint_features < TOLERANCE, "{g}: {joint}");
    }
}

/// Features must notice what is no symmetry: rows exchanged with columns, or x with y.
#[test]
fn the_check_of_value_and_features_fails_for_what_is_no_symmetry() {
    let mut policy = policy();
    let [_, value, features] = outputs(&mut policy, &observations());
    let [h, w, c] = spec().image_shape;
    let original = observations().images;
    let mut transposed = observations();
    for (i, pixel) in transposed.images.chunks_mut(c).enumerate() {
        let (image, row, column) = (i / (h * w), i / w % h, i % w);
        pixel.copy_from_slice(&original[((image * h + column) * w + row) * c..][..c]);
    }
    let mut swapped = observations();
    swapped.vectors.chunks_mut(spec().vector_irreps.len()).for_each(|v| v.swap(0, 1));
    for wrong in [transposed, swapped] {
        let moved = outputs(&mut policy, &wrong);
        assert!(error(&moved[1], &value) > 100.0 * TOLERANCE);
        assert!(error(&moved[2], &features) > 100.0 * TOLERANCE);
    }
}

#[test]
fn the_standard_deviation_does_not_depend_on_the_state() {
    assert_eq!(policy().log_std(), [-0.5; 5]);
}

#[test]
fn the_network_for_128_pixels_is_equivariant() {
    let spec = EnvSpec { num_envs: 1, image_shape: [128, 128, 6], ..spec() };
    let settings = NetworkSettings { action_gain: 1.0, ..NetworkSettings::so2_paper_128px() };
    let mut policy = ActorCriticPolicy::new(&settings, &spec, 5).unwrap();
    for g in D2::ALL {
        let errors = equivariance_errors(&mut policy, &spec, g);
        assert!(errors.iter().all(|&error| error < TOLERANCE), "{g}: {errors:?}");
    }
}

#[test]
fn tanh_gaussian_policies_are_equivariant_with_and_without_a_context() {
    let settings = NetworkSettings {
        encoder: EncoderSettings::Strided { fields: vec![4, 8] },
        action_gain: 1.0,
        ..NetworkSettings::default()
    };
    for group in Group::ALL {
        for context in [None, Some(RecurrentContextSettings { size: 16, length: 2 })] {
            let settings = NetworkSettings { group, ..settings.clone() };
            let mut policy = SacPolicy::new(&settings, context, &spec(), 5).unwrap();
            let errors = |g| equivariance_errors(&mut policy, &spec(), g);
            assert_equivariant_under_only(group, &format!("{context:?}"), errors);
        }
    }
}
