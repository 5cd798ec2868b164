//! One update as PyTorch computed it (`benches/peers/golden_sac.py`), and what is drawn for a
//! minibatch.

use rand::SeedableRng;
use safetensors::SafeTensors;
use symmetry::{Group, Irrep};

use super::*;
use crate::encoder::EncoderSettings;
use crate::env::{EnvSpec, Observations, Transition};
use crate::fixtures;
use crate::network_settings::{CriticSettings, NetworkSettings};
use crate::replay::ReplaySettings;
use crate::sac::minibatch::Augmentation;
use crate::sac::settings::RecurrentContextSettings;

const GOLDEN: &[u8] = include_bytes!("../../tests/golden/sac.safetensors");
const BATCH: usize = 6;

fn golden(name: &str) -> Vec<f64> {
    let tensors = SafeTensors::deserialize(GOLDEN).unwrap();
    let (values, _) = tensors.tensor(name).unwrap().data().as_chunks();
    values.iter().map(|&b| f64::from_le_bytes(b)).collect()
}

fn rounded(name: &str) -> Vec<f32> {
    golden(name).into_iter().map(|x| x as f32).collect()
}

fn spec() -> EnvSpec {
    EnvSpec {
        num_envs: 1,
        image_shape: [1, 1, 1],
        vector_irreps: vec![Irrep::X, Irrep::Y, Irrep::Trivial],
        action_irreps: vec![Irrep::X, Irrep::Trivial],
        choices: vec![],
    }
}

fn network() -> NetworkSettings {
    NetworkSettings {
        group: Group::C1,
        encoder: EncoderSettings::Blind,
        vector_fields: 2,
        actor_fields: 2,
        critic: CriticSettings::Joint { fields: 2 },
        ..NetworkSettings::default()
    }
}

fn settings() -> SacSettings {
    SacSettings {
        gamma: 0.9,
        batch: BATCH,
        window: 1,
        learning_rate: 1e-2,
        max_gradient: 0.05,
        tau: 0.1,
        temperature: EntropyTemperatureSettings::Learned { initial: 0.2, target: -1.0 },
        cloning_weight: 0.3,
        ..SacSettings::default()
    }
}

/// Returns the file's episodes in one replay buffer, one after the other.
fn replay() -> ReplayBuffer {
    let mut replay = ReplayBuffer::new(ReplaySettings::default(), &spec()).unwrap();
    let (vectors, actions) = (rounded("vectors"), rounded("actions"));
    let mut vectors = vectors.chunks(3).peekable();
    let mut steps = actions.chunks(2).zip(rounded("rewards"));
    let see = |vector: &[f32]| Observations { images: vec![0], vectors: vector.to_vec() };
    for episode in golden("episodes").chunks(2) {
        for t in 0..episode[0] as usize {
            let (action, reward) = steps.next().unwrap();
            let now = see(vectors.next().unwrap());
            let next = see(vectors.peek().unwrap());
            let mut transition = Transition::new(&spec());
            transition.rewards[0] = reward;
            if t + 1 == episode[0] as usize {
                let ends = [StepOutcome::Running, StepOutcome::Terminated, StepOutcome::Truncated];
                transition.outcomes[0] = ends[episode[1] as usize];
            }
            transition.final_observations.clone_from(&next);
            transition.observations = next;
            replay.push(&now, action, &transition).unwrap();
        }
        // the observation after the last step begins nothing
        vectors.next();
    }
    replay
}

fn assert_close(what: &str, got: &[f32], expected: &[f64]) {
    assert_eq!(got.len(), expected.len(), "{what}");
    for (i, (&value, wanted)) in got.iter().zip(expected).enumerate() {
        let error = (f64::from(value) - wanted).abs();
        assert!(error < 1e-5, "{what} {i}: {value} {wanted}");
    }
}

fn check(case: &str, context: Option<RecurrentContextSettings>) {
    let of = |part: &str| format!("{case}.{part}");
    let params = rounded(&of("params"));
    let mut policy = SacPolicy::with_params(&network(), context, &spec(), params).unwrap();
    let mut sac = Sac::new(settings(), &policy).unwrap();
    let (noise, targets) = (rounded(&of("noise")), rounded(&of("targets")));
    assert_eq!(sac.target_params.len(), targets.len());
    sac.target_params = targets;
    sac.minibatch = SampledMinibatch {
        indices: Vec::new(),
        steps: golden("indices").into_iter().map(|i| (i as usize, 0)).collect(),
        augmentations: vec![Augmentation::NONE; BATCH],
        noise: [0, 1].map(|i| noise[i * BATCH * 2..(i + 1) * BATCH * 2].to_vec()),
    };
    let sums = sac.losses(&policy, &replay()).unwrap();
    let means = [sums.critic_loss, sums.actor_loss + 0.3 * sums.cloning_loss, sums.log_pi];
    let means = means.map(|sum| (sum / sums.samples) as f32);
    assert_close("losses", &means, &golden(&of("losses")));
    assert_close("gradient", &sac.gradient, &golden(&of("gradient")));
    let mut totals = SacTotals::default();
    sac.clip_and_step(&mut policy, &mut totals).unwrap();
    assert!(totals.clipped > 0.0 && totals.clipped < 1.0);
    sac.update_alpha(&policy, &sums);
    sac.update_targets(&policy);
    let after = golden(&of("log_temperature_after"));
    assert_close("temperature", &sac.log_alpha, &after);
    assert_close("targets", &sac.target_params, &golden(&of("targets_after")));
    assert_close("params", policy.params(), &golden(&of("params_after")));
}

#[test]
fn an_update_is_that_of_pytorch() {
    check("plain", None);
}

#[test]
fn an_update_with_a_context_is_that_of_pytorch() {
    check("context", Some(RecurrentContextSettings { size: 4, length: 3 }));
}

/// Adam's first step moves every parameter that has a gradient by its learning rate.
#[test]
fn the_image_encoder_learns_at_its_own_rate() {
    let moved = |encoder_learning_rate| {
        let settings = SacSettings {
            learning_rate: 1e-2,
            encoder_learning_rate,
            adam_epsilon: 1e-12,
            ..drawn_settings(2)
        };
        let network = fixtures::settings(Group::D2, fixtures::strided());
        let mut policy = SacPolicy::new(&network, None, &fixtures::spec(), 3).unwrap();
        let mut sac = Sac::new(settings, &policy).unwrap();
        let (before, replay) = (policy.params().to_vec(), fixtures::replay());
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        sac.step(&mut policy, &replay, &mut rng, &mut SacTotals::default()).unwrap();
        let encoder = policy.network().trunk.encoder_param_range();
        let pairs = policy.params().iter().zip(&before);
        let steps: Vec<f32> = pairs.map(|(new, old)| (new - old).abs()).collect();
        let largest = |some: &[f32]| some.iter().copied().fold(0.0, f32::max);
        [largest(&steps[encoder.clone()]), largest(&steps[encoder.end..])]
    };
    for (rate, expected) in [(None, 1e-2), (Some(1e-3), 1e-3)] {
        let [encoder, heads] = moved(rate);
        assert!((encoder / expected - 1.0).abs() < 1e-3, "{encoder} {expected}");
        assert!((heads / 1e-2 - 1.0).abs() < 1e-3, "{heads}");
    }
}

/// Averaging changes nothing in what is trained, also if the state is saved and restored midway.
#[test]
fn a_policy_with_an_average_rate_is_the_moving_average_of_what_is_trained() {
    // updates until there were `totals` gradient steps, each with a restored state
    let run = |average_rate: Option<f32>, totals: &[u32]| {
        let (network, replay) =
            (fixtures::settings(Group::D2, fixtures::strided()), fixtures::replay());
        let mut policy = SacPolicy::new(&network, None, &fixtures::spec(), 3).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut last: Option<Sac> = None;
        for &total in totals {
            let updates_per_step = total as f32 / replay.total_recorded_steps() as f32;
            let settings =
                SacSettings { burn_in: 0, updates_per_step, average_rate, ..drawn_settings(2) };
            let mut sac = Sac::new(settings, &policy).unwrap();
            if let Some(saved) = &last {
                sac.restore(&saved.save()).unwrap();
            }
            sac.update(&mut policy, &replay, &mut rng).unwrap();
            assert_eq!(sac.optimiser.steps, u64::from(total));
            last = Some(sac);
        }
        (policy.params().to_vec(), last.map(|sac| sac.trained_params).unwrap_or_default())
    };
    let start = run(None, &[]).0;
    let steps = [1, 2, 3, 4].map(|total| run(None, &[total]).0);
    let (average, trained) = run(Some(0.25), &[2, 4]);
    assert_eq!(trained, steps[3]);
    for (i, &got) in average.iter().enumerate() {
        let expected = steps.iter().fold(start[i], |mean, step| mean + 0.25 * (step[i] - mean));
        assert_eq!(got, expected, "{i}");
    }
    assert_ne!(average, trained);
}

/// The average and what is trained change places during an update, and come back after an error.
#[test]
fn an_update_that_fails_leaves_the_average_in_its_policy() {
    let network = fixtures::settings(Group::D2, fixtures::strided());
    let mut policy = SacPolicy::new(&network, None, &fixtures::spec(), 3).unwrap();
    let settings = SacSettings { burn_in: 0, average_rate: Some(0.5), ..drawn_settings(2) };
    let mut sac = Sac::new(settings, &policy).unwrap();
    let (average, mut rng) = (policy.params().to_vec(), ChaCha8Rng::seed_from_u64(5));
    *sac.trained_params.last_mut().unwrap() = f32::NAN;
    sac.update(&mut policy, &fixtures::replay(), &mut rng).unwrap_err();
    assert_eq!(policy.params(), average);
    assert!(sac.trained_params.last().unwrap().is_nan());
    // an average that is no number is noticed, too, although it is not trained
    let mut whole = Sac::new(sac.settings().clone(), &policy).unwrap();
    policy.params_mut()[0] = f32::NAN;
    let error = whole.update(&mut policy, &fixtures::replay(), &mut rng).unwrap_err();
    assert!(error.to_string().contains("averaged parameter"), "{error}");
}

const SAMPLES: usize = 4000;

fn drawn_settings(window: usize) -> SacSettings {
    SacSettings { batch: 6, window, augmentation: Group::D2, ..SacSettings::default() }
}

/// Counts the draws of each step of the fixtures' replay buffer in windows of `window` steps.
fn counts(window: usize) -> Vec<usize> {
    let settings = drawn_settings(window);
    let (replay, mut minibatch) = (fixtures::replay(), SampledMinibatch::default());
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut counts = vec![0; replay.len()];
    for _ in 0..SAMPLES {
        minibatch.sample(&settings, &replay, &mut rng);
        assert_eq!((minibatch.steps.len(), minibatch.augmentations.len()), (6, 6));
        assert!(minibatch.augmentations.chunks(window).all(|own| own.iter().all(|g| *g == own[0])));
        for &(index, offset) in &minibatch.steps {
            let place = replay.get(index).wrapping_later(offset).index();
            let mut steps = 0..replay.len();
            let found = steps.find(|&i| replay.get(i).index() == place);
            counts[found.unwrap()] += 1;
        }
    }
    counts
}

/// The episodes have four and two steps: the last steps are drawn as often as the first ones. A
/// window of four in an episode of two holds both steps twice.
#[test]
fn every_step_is_drawn_equally_often() {
    for window in [1, 2, 3, 4] {
        let expected = 6 * SAMPLES / 12;
        for count in counts(window) {
            let error = count.abs_diff(expected);
            // five standard errors; the largest is that of windows of three and four, which hold
            // each step of the short episode more than once
            assert!(error < 5 * 54, "{window}: {count} of {expected}");
        }
    }
}

/// Of three windows a share of two thirds begins among the four steps since the mark, and the third
/// one does so in four cases of twelve.
#[test]
fn a_share_of_the_windows_begins_with_the_newest_steps() {
    let drawn = |newest_share| {
        let settings = SacSettings { newest_share, ..drawn_settings(2) };
        let (mut replay, mut minibatch) =
            (fixtures::replay_with_newest(4), SampledMinibatch::default());
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut newest = 0;
        for _ in 0..SAMPLES {
            minibatch.sample(&settings, &replay, &mut rng);
            let begin = minibatch.steps.iter().step_by(2);
            newest += begin.filter(|(index, _)| *index >= 8).count();
        }
        // nothing has come since
        replay.mark_newest_from_now();
        minibatch.sample(&settings, &replay, &mut rng);
        assert_eq!(minibatch.steps.len(), 6);
        newest as f64 / SAMPLES as f64
    };
    for (share, expected) in [(0.0, 1.0), (0.7, 2.0 + 1.0 / 3.0), (1.0, 3.0)] {
        // five standard errors of three windows, each with a third
        let error = (drawn(share) - expected).abs();
        assert!(error < 5.0 * (3.0 * 2.0 / 9.0 / SAMPLES as f64).sqrt(), "{share}: {error}");
    }
}
