//! Losses and gradients of decisions and of minibatches.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use symmetry::Group;

use super::minibatch::Minibatch;
use super::symmetry_loss::SymmetryLossSettings;
use super::*;
use crate::distributions::{ActionDistribution, log_prob};
use crate::encoder::EncoderSettings;
use crate::env::{EnvSpec, Observations, Transition};
use crate::fixtures;
use crate::fixtures::{central_difference, strided};
use crate::network::ActorCritic;
use crate::network_settings::{CriticSettings, NetworkSettings};
use crate::policy::Decisions;

const B: usize = 5;
const WEIGHTS: LossWeights =
    LossWeights { clip_coef: 0.2, vf_coef: 0.5, ent_coef: 0.01, symmetry: 0.0 };

fn total(sums: &LossSums, weights: &LossWeights) -> f64 {
    sums.policy_loss + weights.vf_coef * sums.value_loss - weights.ent_coef * sums.entropy
        + weights.symmetry * sums.symmetry_loss
}

fn gaussian<'a>(mean: &'a [f64], log_std: &'a [f64], value: f64) -> NetworkOutput<'a> {
    NetworkOutput { distribution: ActionDistribution { mean, log_std, choices: &[] }, value }
}

/// Returns the loss of one decision and its gradient; parameters are mean (2), log_std (2), value.
fn decision_loss(p: &[f64], sample: &Decision) -> (f64, [f64; 5]) {
    let output = gaussian(&p[..2], &p[2..4], p[4]);
    let (mut mean, mut log_std) = ([0.0; 2], [0.0; 2]);
    let (sums, value) = WEIGHTS.loss(sample, &output, 1.0, &mut mean, &mut log_std);
    let gradient = [mean[0], mean[1], log_std[0], log_std[1], value];
    (total(&sums, &WEIGHTS), gradient)
}

#[test]
fn gradient_equals_finite_differences_on_every_branch() {
    let p = [0.3, -0.2, -0.5, 0.1, 1.5];
    let action = [0.6, 0.4];
    let now = log_prob(&p[..2], &p[2..4], &action);
    // ratios inside, above and below the clip interval, with both signs of the advantage
    for shift in [0.05, 1.0, -1.0] {
        for advantage in [0.7, -1.3] {
            let sample = Decision { action: &action, log_prob: now - shift, advantage, ret: 0.4 };
            for (i, g) in decision_loss(&p, &sample).1.into_iter().enumerate() {
                let slope =
                    central_difference(&mut p.clone(), i, 1e-5, |p| decision_loss(p, &sample).0);
                assert!((slope - g).abs() < 1e-8, "{shift} {advantage} {i}: {g} {slope}");
            }
        }
    }
}

#[test]
fn an_improvement_beyond_the_clip_has_no_gradient() {
    let p = [0.3, -0.2, -0.5, 0.1, 1.5];
    let action = [0.6, 0.4];
    let now = log_prob(&p[..2], &p[2..4], &action);
    let sample = Decision { action: &action, log_prob: now - 1.0, advantage: 1.0, ret: 0.0 };
    assert_eq!(decision_loss(&p, &sample).1[..2], [0.0, 0.0]);
    let worse = Decision { advantage: -1.0, ..sample };
    assert_ne!(decision_loss(&p, &worse).1[0], 0.0);
}

/// An action far from a narrow policy's mean, such as a mirrored one of a network without the
/// symmetry: a small step of the mean multiplies its probability beyond the range of floats.
#[test]
fn a_ratio_beyond_all_numbers_ends_an_update_and_one_that_is_none_is_an_error() {
    let losses = |log_prob: f64| {
        let sample = Decision { action: &[0.0; 2], log_prob, advantage: -3.0, ret: 0.0 };
        let output = gaussian(&[0.0; 2], &[0.0; 2], 0.0);
        let (mut d_mean, mut d_log_std) = ([0.0; 2], [0.0; 2]);
        WEIGHTS.loss(&sample, &output, 1.0, &mut d_mean, &mut d_log_std).0
    };
    let far = losses(-1e4);
    assert!(far.policy_loss.is_finite() && (250.0 * far.policy_loss.abs()) < f64::from(f32::MAX));
    assert!((far.approx_kl as f32).is_finite() && far.approx_kl / 1e6 > 1e6);
    assert!(losses(f64::NAN).policy_loss.is_nan() && losses(f64::NAN).approx_kl.is_nan());
}

/// By hand: the ratio is e^0.5, so k3 is e^0.5 - 1 - 0.5.
#[test]
fn diagnostics_by_hand() {
    let (p, action) = ([0.0; 2], [0.0; 2]);
    let now = log_prob(&p, &p, &action);
    let sample = Decision { action: &action, log_prob: now - 0.5, advantage: 2.0, ret: 1.0 };
    let output = gaussian(&p, &p, 3.0);
    let (sums, d_value) = WEIGHTS.loss(&sample, &output, 0.25, &mut [0.0; 2], &mut [0.0; 2]);
    assert!((sums.approx_kl - (0.5f64.exp() - 1.5)).abs() < 1e-12);
    assert!((sums.policy_loss + 2.0 * 1.2).abs() < 1e-12);
    assert_eq!((sums.value_loss, sums.clip_fraction, d_value), (4.0, 1.0, 0.5));
}

fn spec() -> EnvSpec {
    EnvSpec { num_envs: B, ..fixtures::spec() }
}

const JOINT: CriticSettings = CriticSettings::Joint { fields: 3 };

fn network(group: Group, encoder: EncoderSettings, critic: CriticSettings) -> ActorCritic<f64> {
    let settings = NetworkSettings { critic, ..fixtures::settings(group, encoder) };
    ActorCritic::new(&settings, &spec()).unwrap()
}

fn uniform(rng: &mut impl Rng, len: usize) -> Vec<f32> {
    (0..len).map(|_| rng.random_range(-1.0..1.0)).collect()
}

/// Returns one random step, whose log-probabilities are off by `shift` times a random number.
fn rollout(
    network: &ActorCritic<f64>,
    params: &[f64],
    shift: f32,
    rng: &mut ChaCha8Rng,
) -> RolloutBuffer {
    let mut observations = Observations::new(&spec());
    observations.images.fill_with(|| rng.random());
    observations.vectors = uniform(rng, B * 3);
    let mut decisions = Decisions::new(&spec());
    decisions.actions = uniform(rng, B * 3);
    let mut workspace = network.new_workspace(B);
    for i in 0..B {
        let (image, vector) = observations.image_and_vector(&spec(), i);
        network.load_observation(i, image, vector, &mut workspace);
    }
    network.forward(params, B, &mut workspace);
    for i in 0..B {
        let action: Vec<f64> =
            decisions.actions[i * 3..i * 3 + 3].iter().map(|&a| f64::from(a)).collect();
        let now = log_prob(&workspace.mean[i * 3..i * 3 + 3], &workspace.log_std, &action);
        decisions.log_probs[i] = now as f32 + shift * rng.random_range(-1.0f32..1.0);
    }
    let mut buffer = RolloutBuffer::new(&spec(), 1).unwrap();
    buffer.push(&observations, &decisions, &Transition::new(&spec()), &[0.0; B]).unwrap();
    buffer
}

fn actions(buffer: &RolloutBuffer) -> Vec<f64> {
    let actions = buffer.decisions().actions.iter();
    actions.map(|&action| f64::from(action)).collect()
}

fn loss(
    network: &ActorCritic<f64>,
    params: &[f64],
    buffer: &RolloutBuffer,
    returns: &[f32],
) -> (LossSums, Vec<f64>) {
    let actions = actions(buffer);
    let minibatch = Minibatch {
        buffer,
        actions: &actions,
        returns,
        indices: &[3, 1, 4, 0, 2],
        advantages: &[0.9, -1.2, 0.3, -0.4, 0.4],
        weights: WEIGHTS,
        augmented: None,
    };
    let mut gradient = vec![0.0; params.len()];
    let mut workspace = network.new_workspace(3);
    let mut sums =
        minibatch.accumulate_chunk_gradients(network, params, 0..3, &mut workspace, &mut gradient);
    sums.add_sums(&minibatch.accumulate_chunk_gradients(
        network,
        params,
        3..B,
        &mut workspace,
        &mut gradient,
    ));
    (sums, gradient)
}

#[test]
fn gradient_of_the_whole_loss_equals_finite_differences() {
    for group in Group::ALL {
        for critic in [JOINT, CriticSettings::Pooled { width: 3 }] {
            gradient_equals_finite_differences(&network(group, strided(), critic));
        }
    }
    let pooled = EncoderSettings::Pooled { fields: vec![], inner: [2, 2] };
    gradient_equals_finite_differences(&network(Group::D2, pooled, JOINT));
}

fn gradient_equals_finite_differences(network: &ActorCritic<f64>) {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut params = network.init_params(&mut rng);
    let buffer = rollout(network, &params, 0.5, &mut rng);
    let returns = uniform(&mut rng, B);
    let (sums, gradient) = loss(network, &params, &buffer, &returns);
    assert!(sums.clip_fraction > 0.0 && sums.clip_fraction < B as f64, "{sums:?}");
    let scale = gradient.iter().fold(0.0, |m: f64, g| m.max(g.abs()));
    for (i, g) in gradient.iter().enumerate() {
        let slope = central_difference(&mut params, i, 1e-6, |params| {
            total(&loss(network, params, &buffer, &returns).0, &WEIGHTS) / B as f64
        });
        assert!((slope - g).abs() < 1e-7 * scale.max(1.0), "{i}: {g} {slope}");
    }
    assert!(gradient.iter().filter(|g| **g != 0.0).count() > params.len() / 2);
}

/// Decisions are compared with their own transformed ones, in any order and chunks.
#[test]
fn a_symmetry_loss_is_a_sum_over_decisions() {
    let network = network(Group::C1, strided(), JOINT);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let params = network.init_params(&mut rng);
    let buffer = rollout(&network, &params, 0.5, &mut rng);
    let actions = actions(&buffer);
    let symmetry = SymmetryLossSettings::default();
    let (augmented, returns) = (symmetry.augment(&buffer, &mut rng), uniform(&mut rng, B));
    let weights = LossWeights { symmetry: 0.7, ..WEIGHTS };
    let run = |indices: &[usize], ends: &[usize]| {
        let minibatch = Minibatch {
            buffer: &buffer,
            actions: &actions,
            returns: &returns,
            indices,
            advantages: &[0.0; B],
            weights,
            augmented: Some(&augmented),
        };
        let (mut sum, mut gradient) = (0.0, vec![0.0; params.len()]);
        let mut workspace = network.new_workspace(B);
        let mut from = 0;
        for &end in ends {
            let chunk = from..end;
            from = end;
            let sums = minibatch.accumulate_chunk_gradients(
                &network,
                &params,
                chunk,
                &mut workspace,
                &mut gradient,
            );
            sum += sums.symmetry_loss;
        }
        (sum, gradient)
    };
    let (whole, at_once) = run(&[0, 1, 2, 3, 4], &[B]);
    let (parts, in_chunks) = run(&[3, 1, 4, 0, 2], &[3, B]);
    assert!(whole > 1e-6 && (whole - parts).abs() < 1e-12 * whole);
    for (a, b) in at_once.iter().zip(&in_chunks) {
        assert!((a - b).abs() < 1e-12, "{a} {b}");
    }
}

#[test]
fn advantages_are_normalised_within_the_minibatch() {
    let mut out = Vec::new();
    normalise(&[9.0, 1.0, 3.0, 5.0], &[1, 2, 3], &mut out);
    for (a, expected) in out.iter().zip([-1.0, 0.0, 1.0]) {
        assert!((a - expected).abs() < 1e-7);
    }
    normalise(&[9.0], &[0], &mut out);
    assert_eq!(out, [0.0]);
}
