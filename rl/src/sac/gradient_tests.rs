//! The gradient against finite differences, and the losses under the group.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use symmetry::{D2, Group};

use super::*;
use crate::encoder::EncoderSettings;
use crate::env::{Observations, transform_vector};
use crate::fixtures::{network, replay, settings, slope, spec, strided};
use crate::policy::{Actor, ActorMemory};
use crate::replay::ReplayBuffer;
use crate::sac::minibatch::Batch;
use crate::sac::network::SacNetwork;
use crate::sac::policy::SacPolicy;
use crate::sac::settings::ContextSettings;

const ALPHA: f64 = 0.2;
const CLONING: f64 = 0.3;
const A: usize = 3;
/// A window of three steps, the last of which comes after the episode's end, and two other steps.
const STEPS: [(usize, usize); 5] = [(4, 0), (4, 1), (4, 2), (7, 0), (11, 0)];

/// A network with parameters, target critics, and the random draws of a minibatch.
struct Case {
    network: SacNetwork<f64>,
    params: Vec<f64>,
    targets: Vec<f64>,
    noise: [Vec<f32>; 2],
    elements: [D2; STEPS.len()],
    gamma: f64,
}

impl Case {
    fn new(network: SacNetwork<f64>, gamma: f64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let params = network.init_params(&mut rng);
        let targets = network.init_params(&mut rng)[network.critic_params()].to_vec();
        let mut noise = || (0..STEPS.len() * A).map(|_| rng.random_range(-1.5..1.5)).collect();
        Self {
            noise: [noise(), noise()],
            network,
            params,
            targets,
            elements: [D2::Identity; STEPS.len()],
            gamma,
        }
    }

    /// Transforms every step and its noise by g.
    fn moved(mut self, g: D2) -> Self {
        self.elements = [g; STEPS.len()];
        let irreps = &self.network.spec().action_irreps;
        for noise in &mut self.noise {
            let rows = noise.chunks(A).flat_map(|row| transform_vector(g, row, irreps));
            *noise = rows.collect();
        }
        self
    }

    /// Returns sums and gradient, in chunks of one workspace, and the actor's output of the last
    /// chunk.
    fn run_in(&self, chunk: usize, replay: &ReplayBuffer) -> (SacSums, Vec<f64>, Vec<f64>) {
        let losses = Losses {
            network: &self.network,
            params: &self.params,
            targets: &self.targets,
            batch: Batch {
                replay,
                steps: &STEPS,
                elements: &self.elements,
                noise: [&self.noise[0], &self.noise[1]],
                gamma: self.gamma,
                alpha: ALPHA,
                cloning: CLONING,
            },
        };
        let mut gradient = vec![0.0; self.params.len()];
        let mut w = self.network.workspace(chunk);
        let mut sums = SacSums::default();
        for start in (0..STEPS.len()).step_by(chunk) {
            let range = start..STEPS.len().min(start + chunk);
            sums.add(&losses.chunk(range, &mut w, &mut gradient));
        }
        (sums, gradient, w.output)
    }

    /// Returns the sums, the gradient and the output of a minibatch that is computed in two chunks.
    fn run(&self, replay: &ReplayBuffer) -> (SacSums, Vec<f64>, Vec<f64>) {
        let (sums, gradient, output) = self.run_in(3, replay);
        (sums, gradient, output[..2 * 2 * A].to_vec())
    }
}

/// Checks that the loss of each part alone trains its parameters. Without a discount, targets do
/// not depend on the parameters. The shared part is not trained through a context, so it is left
/// out if there is one.
fn check_gradient(network: SacNetwork<f64>) {
    let replay = replay();
    let mut case = Case::new(network, 0.0);
    let parts = case.network.parts();
    let actors = parts.actor_reader.start..parts.actor.end;
    let (_, gradient, _) = case.run(&replay);
    let from = if case.network.context().is_some() { case.network.trunk.params().end } else { 0 };
    let mut params = case.params.clone();
    let scale = gradient.iter().fold(1.0, |m: f64, g| m.max(g.abs()));
    // a wrong formula is wrong nearly everywhere
    for i in (from..gradient.len()).step_by(7) {
        let slope = slope(&mut params, i, 1e-6, |moved| {
            case.params.copy_from_slice(moved);
            let (sums, ..) = case.run(&replay);
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
    let case = || Case::new(network(group, strided(), context), 0.9);
    let (sums, gradient, output) = case().run(&replay);
    let (moved_sums, moved_gradient, moved_output) = case().moved(g).run(&replay);
    let losses = |case_sums: &SacSums| {
        [case_sums.critic_loss, case_sums.actor_loss, case_sums.value, case_sums.log_pi]
    };
    let irreps = &spec().action_irreps;
    let split = |both: &[f64], first: bool| -> Vec<f64> {
        let rows = both.chunks(2 * A);
        rows.flat_map(|row| if first { row[..A].to_vec() } else { row[A..].to_vec() }).collect()
    };
    let signs = irreps.iter().map(|irrep| f64::from(irrep.sign(g))).cycle();
    let means: Vec<f64> = split(&output, true).iter().zip(signs).map(|(m, s)| m * s).collect();
    [
        distance(&losses(&moved_sums), &losses(&sums)),
        distance(&moved_gradient, &gradient),
        distance(&split(&moved_output, true), &means),
        distance(&split(&moved_output, false), &split(&output, false)),
    ]
}

/// Q and log_std are invariant and means equivariant, so augmentation by the network's own group
/// changes neither losses nor gradient.
#[test]
fn a_symmetric_network_learns_the_same_from_moved_steps() {
    for group in Group::ALL {
        for context in [false, true] {
            for &g in group.elements() {
                for error in asymmetry(group, g, context) {
                    assert!(error < 1e-12, "{group}, {g}, {context}: {error}");
                }
            }
        }
    }
}

#[test]
fn a_network_without_the_symmetry_learns_something_else_from_moved_steps() {
    for group in Group::ALL {
        for g in D2::ALL.into_iter().filter(|&g| !group.contains(g)) {
            for error in asymmetry(group, g, false) {
                assert!(error > 1e-4, "{group}, {g}: {error}");
            }
        }
    }
}

/// A time-out bootstraps the value of the final observation, a termination bootstraps zero.
#[test]
fn only_a_termination_ends_what_is_to_come() {
    let replay = replay();
    let case = Case::new(network(Group::D2, strided(), false), 0.9);
    let mut w = case.network.workspace(3);
    let batch = Batch {
        replay: &replay,
        // the last steps of the two episodes, and the first of the next one
        steps: &[(6, 0), (7, 0), (8, 0)],
        elements: &case.elements[..3],
        noise: [&case.noise[0][..3 * A], &case.noise[1][..3 * A]],
        gamma: 0.9,
        alpha: ALPHA,
        cloning: 0.0,
    };
    let losses =
        Losses { network: &case.network, params: &case.params, targets: &case.targets, batch };
    batch.load(&case.network, &case.params, &(0..3), &mut w);
    losses.run_next(&(0..3), &mut w);
    losses.next_q_values(&(0..3), &mut w);
    let beyond = |slot: usize| w.next_q_values[slot] - f64::from(replay.get(6 + slot).reward());
    assert_eq!(replay.get(6).outcome(), StepOutcome::Truncated);
    assert_eq!(replay.get(7).outcome(), StepOutcome::Terminated);
    assert_eq!(beyond(1), 0.0);
    for slot in [0, 2] {
        let worth = w.min_qf(slot).1 - ALPHA * w.log_pi[slot];
        assert!((beyond(slot) - 0.9 * worth).abs() < 1e-12 && worth != 0.0);
    }
}

/// Returns the observations of both environments at a step of the replay buffer.
fn seen(replay: &ReplayBuffer, step: usize) -> Observations {
    let spec = spec();
    let both = [0, 1].map(|env| replay.get(2 * step + env));
    let mut seen = Observations::new(&spec);
    for (image, held) in seen.images.chunks_mut(spec.image_len()).zip(both) {
        held.image(image);
    }
    seen.vectors = both.map(|held| held.vector()).concat();
    seen
}

/// Returns the actor's mean actions at a step, computed from the replay buffer.
fn trained(policy: &SacPolicy, replay: &ReplayBuffer, step: usize) -> Vec<f64> {
    let network = policy.network();
    let losses = Losses {
        network,
        params: policy.params(),
        targets: &policy.params()[network.critic_params()],
        batch: Batch {
            replay,
            steps: &[(2 * step, 0), (2 * step + 1, 0)],
            elements: &[D2::Identity; 2],
            noise: [&[0.0; 2 * A]; 2],
            gamma: 0.9,
            alpha: ALPHA,
            cloning: 0.0,
        },
    };
    let mut w = network.workspace(2);
    losses.chunk(0..2, &mut w, &mut vec![0.0; network.num_params()]);
    w.actions
}

/// An acting policy remembers the same context that an update reads from the replay buffer, at
/// every step of an episode.
#[test]
fn an_actor_decides_from_the_context_that_it_is_trained_with() {
    let replay = replay();
    let context = Some(ContextSettings { size: 4, length: 3 });
    let settings = settings(Group::D2, strided());
    let mut policy = SacPolicy::new(&settings, context, &spec(), 4).unwrap();
    let (mut memory, mut means) = (policy.new_memory(2), vec![0.0; 2 * A]);
    for step in 0..6 {
        let expected = trained(&policy, &replay, step);
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
        let case = Case::new(network(Group::D2, strided(), context), 0.9);
        let (together, gradient, _) = case.run_in(STEPS.len(), &replay);
        let (single, expected, _) = case.run_in(1, &replay);
        assert!((together.critic_loss - single.critic_loss).abs() < 1e-12);
        assert!((together.actor_loss - single.actor_loss).abs() < 1e-12);
        assert!(distance(&gradient, &expected) < 1e-12);
    }
}

/// Three consecutive steps need four observations; with a context, also those of the two steps
/// before them, if the episode has them.
#[test]
fn each_observation_is_shown_once() {
    let replay = replay();
    let shown = |context, index| {
        let case = Case::new(network(Group::D2, strided(), context), 0.9);
        let mut w = case.network.workspace(3);
        let batch = Batch {
            replay: &replay,
            steps: &[(index, 0), (index, 1), (index, 2)],
            elements: &[D2::FlipX; 3],
            noise: [&[], &[]],
            gamma: 0.9,
            alpha: ALPHA,
            cloning: 0.0,
        };
        batch.load(&case.network, &case.params, &(0..3), &mut w);
        w.observed.len()
    };
    assert_eq!([shown(false, 0), shown(false, 2)], [4, 4]);
    assert_eq!([shown(true, 0), shown(true, 2)], [4, 5]);
    // the window goes on at the episode's beginning
    assert_eq!([shown(false, 4), shown(false, 6)], [5, 5]);
}
