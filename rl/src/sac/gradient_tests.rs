//! The gradient against finite differences, and the losses under the group.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use symmetry::{D2, Group};

use super::*;
use crate::encoder::EncoderSettings;
use crate::env::{Observations, transform_vector};
use crate::fixtures::{central_difference, network, replay, settings, spec, strided};
use crate::policy::{Actor, ActorMemory};
use crate::replay::ReplayBuffer;
use crate::sac::minibatch::Augmentation;
use crate::sac::network::SacNetwork;
use crate::sac::policy::SacPolicy;
use crate::sac::settings::RecurrentContextSettings;

const ALPHA: f64 = 0.2;
const CLONING: f64 = 0.3;
const A: usize = 3;
/// A window of three steps, the last of which comes after the episode's end, and two other steps.
const STEPS: [(usize, usize); 5] = [(4, 0), (4, 1), (4, 2), (7, 0), (11, 0)];

/// A network with its parameters, target critics, and a sampled minibatch.
struct Case<T> {
    network: SacNetwork<T>,
    params: Vec<T>,
    target_params: Vec<T>,
    minibatch: SampledMinibatch,
    gamma: f64,
}

impl<T: Scalar> Case<T> {
    fn new(network: SacNetwork<T>, steps: &[(usize, usize)], gamma: f64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let params = network.init_params(&mut rng);
        let target_params = network.init_params(&mut rng)[network.critic_param_range()].to_vec();
        let mut noise = || (0..steps.len() * A).map(|_| rng.random_range(-1.5..1.5)).collect();
        let minibatch = SampledMinibatch {
            indices: Vec::new(),
            steps: steps.to_vec(),
            augmentations: vec![Augmentation::NONE; steps.len()],
            noise: [noise(), noise()],
        };
        Self { network, params, target_params, minibatch, gamma }
    }

    /// Transforms every step and its noise by g.
    fn moved(mut self, g: D2) -> Self {
        self.minibatch.augmentations.fill(Augmentation { element: g, shift: [0, 0] });
        let irreps = &self.network.spec().action_irreps;
        for noise in &mut self.minibatch.noise {
            let rows = noise.chunks(A).flat_map(|row| transform_vector(g, row, irreps));
            *noise = rows.collect();
        }
        self
    }

    fn losses<'a>(&'a self, replay: &'a ReplayBuffer) -> Losses<'a, T> {
        Losses {
            network: &self.network,
            params: &self.params,
            target_params: &self.target_params,
            replay,
            minibatch: &self.minibatch,
            gamma: self.gamma,
            alpha: ALPHA,
            cloning_weight: CLONING,
        }
    }

    /// Returns sums and gradient, in chunks of one workspace, which holds the last chunk's outputs.
    fn run(&self, chunk: usize, replay: &ReplayBuffer) -> (SacSums, Vec<T>, SacWorkspace<T>) {
        let mut gradient = vec![T::ZERO; self.params.len()];
        let mut w = self.network.new_workspace(chunk);
        let mut sums = SacSums::default();
        let steps = self.minibatch.steps.len();
        for start in (0..steps).step_by(chunk) {
            let range = start..steps.min(start + chunk);
            sums.add_sums(&self.losses(replay).accumulate_chunk_gradients(
                range,
                &mut w,
                &mut gradient,
            ));
        }
        (sums, gradient, w)
    }
}

/// Checks that the loss of each part alone trains its parameters. Without a discount, targets do
/// not depend on the parameters. The shared part is not trained through a context, so it is left
/// out if there is one.
fn check_gradient(network: SacNetwork<f64>) {
    let replay = replay();
    let mut case = Case::new(network, &STEPS, 0.0);
    let ranges = case.network.param_ranges();
    let actors = ranges.actor_reader.start..ranges.actor.end;
    let (_, gradient, _) = case.run(3, &replay);
    let from = if case.network.context_settings().is_some() {
        case.network.trunk.param_range().end
    } else {
        0
    };
    let mut params = case.params.clone();
    let scale = gradient.iter().fold(1.0, |m: f64, g| m.max(g.abs()));
    // a wrong formula is wrong nearly everywhere
    for i in (from..gradient.len()).step_by(7) {
        let slope = central_difference(&mut params, i, 1e-6, |moved| {
            case.params.copy_from_slice(moved);
            let (sums, ..) = case.run(3, &replay);
            let actor = sums.actor_loss + CLONING * sums.cloning_loss;
            let loss = if actors.contains(&i) { actor } else { sums.critic_loss };
            loss / STEPS.len() as f64
        });
        let error = (slope - gradient[i]).abs();
        assert!(error < 1e-7 * scale, "{i}: {} {slope}", gradient[i]);
    }
    assert!(gradient.iter().filter(|g| **g != 0.0).count() > gradient.len() / 2);
}

#[test]
fn the_gradient_of_both_losses_equals_finite_differences() {
    for group in Group::ALL {
        for encoder in [strided(), EncoderSettings::Blind] {
            check_gradient(network(group, encoder, false));
        }
        check_gradient(network(group, EncoderSettings::Blind, true));
    }
}

/// Returns the largest difference between two lists of numbers.
fn distance(a: &[f64], b: &[f64]) -> f64 {
    let differences = a.iter().zip(b).map(|(a, b)| (a - b).abs());
    differences.fold(0.0, f64::max)
}

/// Returns the differences of losses, gradient, means and log_std from those of an equivariant
/// network when every step of the minibatch is transformed by g.
fn asymmetry(group: Group, g: D2, context: bool) -> [f64; 4] {
    let replay = replay();
    let case = || Case::new(network(group, strided(), context), &STEPS, 0.9);
    let outputs = |of: Case<f64>| {
        let (sums, gradient, w) = of.run(3, &replay);
        let losses = vec![sums.critic_loss, sums.actor_loss, sums.value, sums.log_pi];
        // the last chunk has two steps
        let rows = w.output[..2 * 2 * A].chunks(2 * A);
        let half = |from: usize| rows.clone().flat_map(move |row| &row[from..from + A]).copied();
        [losses, gradient, half(0).collect(), half(A).collect()]
    };
    let [losses, gradient, means, log_stds] = outputs(case());
    let signs = spec().action_irreps.into_iter().map(|irrep| f64::from(irrep.sign(g))).cycle();
    let means = means.iter().zip(signs).map(|(m, s)| m * s).collect();
    let expected: [Vec<f64>; 4] = [losses, gradient, means, log_stds];
    let found = outputs(case().moved(g));
    [0, 1, 2, 3].map(|i: usize| distance(&found[i], &expected[i]))
}

/// Q and log_std are invariant and means equivariant, so augmentation by the network's own group
/// changes neither losses nor gradient. A network without the symmetry learns something else.
#[test]
fn a_symmetric_network_learns_the_same_from_moved_steps_and_others_do_not() {
    for group in Group::ALL {
        for context in [false, true] {
            for g in D2::ALL.into_iter().filter(|&g| !context || group.contains(g)) {
                for error in asymmetry(group, g, context) {
                    let as_expected = if group.contains(g) { error < 1e-12 } else { error > 1e-4 };
                    assert!(as_expected, "{group}, {g}, {context}: {error}");
                }
            }
        }
    }
}

/// A time-out bootstraps the value of the final observation, a termination bootstraps zero.
#[test]
fn only_a_termination_ends_what_is_to_come() {
    let replay = replay();
    // the last steps of the two episodes, and the first of the next one
    let steps = [(6, 0), (7, 0), (8, 0)];
    let case = Case::new(network(Group::D2, strided(), false), &steps, 0.9);
    let mut w = case.network.new_workspace(3);
    let losses = case.losses(&replay);
    losses.encode_observations(&(0..3), &mut w);
    losses.run_next_observations(&(0..3), &mut w);
    losses.write_td_targets(&(0..3), &mut w);
    let beyond = |slot: usize| w.td_targets[slot] - f64::from(replay.get(6 + slot).reward());
    assert_eq!(replay.get(6).outcome(), StepOutcome::Truncated);
    assert_eq!(replay.get(7).outcome(), StepOutcome::Terminated);
    assert_eq!(beyond(1), 0.0);
    for slot in [0, 2] {
        let worth = w.min_q_value(slot).1 - ALPHA * w.log_pi[slot];
        assert!((beyond(slot) - 0.9 * worth).abs() < 1e-12 && worth != 0.0);
    }
}

fn seen(replay: &ReplayBuffer, step: usize) -> Observations {
    let spec = spec();
    let both = [0, 1].map(|env| replay.get(2 * step + env));
    let mut seen = Observations::new(&spec);
    for (image, held) in seen.images.chunks_mut(spec.image_len()).zip(both) {
        held.write_image(image);
    }
    seen.vectors = both.map(|held| held.observation_vector()).concat();
    seen
}

/// An acting policy remembers the same context that an update reads from the replay buffer, at
/// every step of an episode.
#[test]
fn an_actor_decides_from_the_context_that_it_is_trained_with() {
    let replay = replay();
    let context = Some(RecurrentContextSettings { size: 4, length: 3 });
    let settings = settings(Group::D2, strided());
    let mut policy = SacPolicy::new(&settings, context, &spec(), 4).unwrap();
    let (mut memory, mut means) = (policy.new_memory(2), vec![0.0; 2 * A]);
    for step in 0..6 {
        let network = SacNetwork::<f32>::new(&settings, context, &spec()).unwrap();
        let mut case = Case::new(network, &[(2 * step, 0), (2 * step + 1, 0)], 0.9);
        case.params.copy_from_slice(policy.params());
        case.minibatch.noise.iter_mut().for_each(|noise| noise.fill(0.0));
        let expected = case.run(2, &replay).2.actions;
        let error = |got: &[f32]| {
            let got: Vec<f64> = got.iter().map(|&m| m.into()).collect();
            distance(&got, &expected)
        };
        let observations = seen(&replay, step);
        let mut forgetful = policy.new_memory(2);
        policy.mean_actions(&observations, &mut forgetful, &mut means).unwrap();
        // the fourth step ends both episodes
        assert_eq!(error(&means) < 1e-6, step % 4 == 0, "{step}");
        policy.mean_actions(&observations, &mut memory, &mut means).unwrap();
        assert!(error(&means) < 1e-6, "{step}: {}", error(&means));
        for env in 0..2 {
            let recorded = replay.get(2 * step + env);
            memory.remember_step(env, recorded.action(), recorded.reward());
            if recorded.outcome().is_ended() {
                memory.forget_episode(env);
            }
        }
    }
}

/// Steps of a window share observations, but give the same gradient as single steps.
#[test]
fn what_is_shared_changes_nothing() {
    let replay = replay();
    for context in [false, true] {
        let case = Case::new(network(Group::D2, strided(), context), &STEPS, 0.9);
        let (together, gradient, _) = case.run(STEPS.len(), &replay);
        let (single, expected, _) = case.run(1, &replay);
        assert!((together.critic_loss - single.critic_loss).abs() < 1e-12);
        assert!((together.actor_loss - single.actor_loss).abs() < 1e-12);
        assert!(distance(&gradient, &expected) < 1e-12);
    }
}

/// A shift and the half turn after it are the half turn and the opposite shift after it, so an
/// equivariant network learns the same from steps that were moved either way.
#[test]
fn images_are_shifted_before_they_are_transformed() {
    let replay = replay();
    let case = |element, shift| {
        let mut case = Case::new(network(Group::D2, strided(), false), &STEPS, 0.9).moved(element);
        case.minibatch.augmentations.fill(Augmentation { element, shift });
        case.run(STEPS.len(), &replay).1
    };
    let shifted = case(D2::Identity, [1, -1]);
    assert!(distance(&shifted, &case(D2::HalfTurn, [1, -1])) < 1e-9);
    assert!(distance(&shifted, &case(D2::Identity, [0, 0])) > 1e-3);
    assert!(distance(&shifted, &case(D2::HalfTurn, [-1, 1])) > 1e-3);
}

/// Three consecutive steps need four observations; with a context, also those of the two steps
/// before them, if the episode has them.
#[test]
fn each_observation_is_encoded_once() {
    let replay = replay();
    let encoded = |context, index| {
        let steps = [(index, 0), (index, 1), (index, 2)];
        let case = Case::new(network(Group::D2, strided(), context), &steps, 0.9);
        let case = case.moved(D2::FlipX);
        let mut w = case.network.new_workspace(3);
        case.losses(&replay).encode_observations(&(0..3), &mut w);
        w.observation_keys.len()
    };
    assert_eq!([encoded(false, 0), encoded(false, 2)], [4, 4]);
    assert_eq!([encoded(true, 0), encoded(true, 2)], [4, 5]);
    // the window goes on at the episode's beginning
    assert_eq!([encoded(false, 4), encoded(false, 6)], [5, 5]);
}
