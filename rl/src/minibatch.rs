//! Loss and gradient of one minibatch, computed chunk by chunk.

use std::ops::Range;

use equivariant::Scalar;

use crate::buffer::RolloutBuffer;
use crate::loss::{LossSums, LossWeights, Output, Sample, sample_loss};
use crate::network::ActorCritic;
use crate::pass::Workspace;
use crate::symmetry_loss::Moved;

/// A minibatch of B decisions of a rollout.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Minibatch<'a> {
    pub buffer: &'a RolloutBuffer,
    /// Actions of the whole rollout, `[T, N, A]`.
    pub actions: &'a [f64],
    /// Returns of the whole rollout, `[T, N]`.
    pub returns: &'a [f32],
    /// Which decisions belong to the minibatch, `[B]`.
    pub indices: &'a [usize],
    /// Their normalised advantages, `[B]`.
    pub advantages: &'a [f64],
    pub weights: LossWeights,
    /// The decisions of the rollout moved, where broken symmetries cost something.
    pub moved: Option<&'a Moved>,
}

impl Minibatch<'_> {
    /// Runs the samples at positions `range` of the minibatch forward and backward. Adds their
    /// share of the gradient of the mean loss to `gradient` and returns the sums of their loss
    /// terms.
    pub fn chunk<T: Scalar>(
        &self,
        network: &ActorCritic<T>,
        params: &[T],
        range: Range<usize>,
        workspace: &mut Workspace<T>,
        gradient: &mut [T],
    ) -> LossSums {
        for (slot, &i) in self.indices[range.clone()].iter().enumerate() {
            let (image, vector) = self.buffer.observations().sample(self.buffer.spec(), i);
            network.load(slot, image, vector, workspace);
        }
        network.forward(params, range.len(), workspace);
        let mut sums = self.loss(range.clone(), workspace);
        network.backward(params, range.len(), workspace, gradient);
        if let Some(moved) = self.moved {
            let scale = 1.0 / self.indices.len() as f64;
            let part = (self.buffer.spec(), &self.indices[range]);
            let network = (network, params);
            sums.symmetry = moved.chunk(network, part, &self.weights, scale, workspace, gradient);
        }
        sums
    }

    /// Sums the loss terms of a chunk and leaves their gradients in the workspace.
    fn loss<T>(&self, range: Range<usize>, w: &mut Workspace<T>) -> LossSums {
        let width = w.log_std.len();
        let scale = 1.0 / self.indices.len() as f64;
        let mut sums = LossSums::default();
        w.d_log_std.fill(0.0);
        for (slot, position) in range.enumerate() {
            let own = slot * width..(slot + 1) * width;
            let output = Output {
                mean: &w.mean[own.clone()],
                log_std: &w.log_std,
                value: w.value[slot],
            };
            let (terms, d_value) = sample_loss(
                &self.weights,
                &self.sample(position, width),
                &output,
                scale,
                &mut w.d_mean[own],
                &mut w.d_log_std,
            );
            w.d_value[slot] = d_value;
            sums.add(&terms);
        }
        sums
    }

    /// The decision at `position` of the minibatch, with an action of `width` components.
    fn sample(&self, position: usize, width: usize) -> Sample<'_> {
        let i = self.indices[position];
        Sample {
            action: &self.actions[i * width..(i + 1) * width],
            log_prob: f64::from(self.buffer.decisions().log_probs[i]),
            advantage: self.advantages[position],
            target: f64::from(self.returns[i]),
        }
    }
}

/// Writes the advantages at `indices`, shifted and scaled to mean 0 and sample standard deviation
/// 1.
///
/// Per minibatch, as in Stable-Baselines3 (`PPO.train`) and detail 7 of "The 37 implementation
/// details of PPO" (Huang et al., ICLR blog track 2022).
pub(crate) fn normalised_advantages(advantages: &[f32], indices: &[usize], out: &mut Vec<f64>) {
    out.clear();
    out.extend(indices.iter().map(|&i| f64::from(advantages[i])));
    let count = out.len() as f64;
    let mean = out.iter().sum::<f64>() / count;
    let squares = out.iter().map(|a| (a - mean).powi(2)).sum::<f64>();
    let std = (squares / (count - 1.0).max(1.0)).sqrt();
    out.iter_mut().for_each(|a| *a = (*a - mean) / (std + 1e-8));
}

#[cfg(test)]
mod tests {
    use rand::{Rng, RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use symmetry::Group;

    use super::*;
    use crate::encoder::Encoder;
    use crate::env::{EnvSpec, Observations, Transition};
    use crate::fixtures::{self, strided};
    use crate::gaussian::log_prob;
    use crate::network_settings::{Critic, NetworkSettings};
    use crate::policy::Decisions;

    const B: usize = 5;
    const WEIGHTS: LossWeights = LossWeights {
        clip: 0.2,
        value: 0.5,
        entropy: 0.01,
        symmetry: 0.0,
    };

    fn spec() -> EnvSpec {
        EnvSpec {
            num_envs: B,
            ..fixtures::spec()
        }
    }

    const JOINT: Critic = Critic::Joint { fields: 3 };

    fn network(group: Group, encoder: Encoder, critic: Critic) -> ActorCritic<f64> {
        let settings = NetworkSettings {
            critic,
            ..fixtures::settings(group, encoder)
        };
        ActorCritic::new(&settings, &spec()).unwrap()
    }

    fn uniform(rng: &mut impl Rng, len: usize) -> Vec<f32> {
        (0..len).map(|_| rng.random_range(-1.0..1.0)).collect()
    }

    /// One random step, with log-probabilities that are `shift` times a random number off.
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
        let mut workspace = network.workspace(B);
        for i in 0..B {
            let (image, vector) = observations.sample(&spec(), i);
            network.load(i, image, vector, &mut workspace);
        }
        network.forward(params, B, &mut workspace);
        for i in 0..B {
            let action: Vec<f64> = decisions.actions[i * 3..i * 3 + 3]
                .iter()
                .map(|&a| f64::from(a))
                .collect();
            let now = log_prob(
                &workspace.mean[i * 3..i * 3 + 3],
                &workspace.log_std,
                &action,
            );
            decisions.log_probs[i] = now as f32 + shift * rng.random_range(-1.0f32..1.0);
        }
        let mut buffer = RolloutBuffer::new(&spec(), 1).unwrap();
        buffer
            .push(
                &observations,
                &decisions,
                &Transition::new(&spec()),
                &[0.0; B],
            )
            .unwrap();
        buffer
    }

    fn actions(buffer: &RolloutBuffer) -> Vec<f64> {
        let actions = buffer.decisions().actions.iter();
        actions.map(|&action| f64::from(action)).collect()
    }

    /// Loss sums and gradient of the whole buffer in two chunks of one workspace.
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
            moved: None,
        };
        let mut gradient = vec![0.0; params.len()];
        let mut workspace = network.workspace(3);
        let mut sums = minibatch.chunk(network, params, 0..3, &mut workspace, &mut gradient);
        sums.add(&minibatch.chunk(network, params, 3..B, &mut workspace, &mut gradient));
        (sums, gradient)
    }

    #[test]
    fn gradient_of_the_whole_loss_equals_finite_differences() {
        for group in Group::ALL {
            for critic in [JOINT, Critic::Pooled { width: 3 }] {
                gradient_equals_finite_differences(&network(group, strided(), critic));
            }
        }
        let pooled = Encoder::Pooled {
            fields: vec![],
            inner: [2, 2],
        };
        let keypoints = Encoder::Keypoints {
            fields: vec![2],
            maps: 2,
        };
        for encoder in [pooled, keypoints] {
            gradient_equals_finite_differences(&network(Group::D2, encoder, JOINT));
        }
    }

    fn gradient_equals_finite_differences(network: &ActorCritic<f64>) {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut params = network.init(&mut rng);
        let buffer = rollout(network, &params, 0.5, &mut rng);
        let returns = uniform(&mut rng, B);
        let (sums, gradient) = loss(network, &params, &buffer, &returns);
        assert!(sums.clipped > 0.0 && sums.clipped < B as f64, "{sums:?}");
        let scale = gradient.iter().fold(0.0, |m: f64, g| m.max(g.abs()));
        for i in 0..params.len() {
            let centre = params[i];
            let mut at = |h: f64| {
                params[i] = centre + h;
                loss(network, &params, &buffer, &returns).0.total(&WEIGHTS) / B as f64
            };
            let slope = (at(1e-6) - at(-1e-6)) / 2e-6;
            params[i] = centre;
            assert!(
                (slope - gradient[i]).abs() < 1e-7 * scale.max(1.0),
                "{i}: {} {slope}",
                gradient[i]
            );
        }
        assert!(gradient.iter().filter(|g| **g != 0.0).count() > params.len() / 2);
    }

    /// Decisions meet their own moved ones, whatever the order and the chunks.
    #[test]
    fn a_symmetry_loss_is_a_sum_over_decisions() {
        let network = network(Group::C1, strided(), JOINT);
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let params = network.init(&mut rng);
        let buffer = rollout(&network, &params, 0.5, &mut rng);
        let actions = actions(&buffer);
        let symmetry = crate::SymmetryLoss::default();
        let (moved, returns) = (symmetry.draw(&buffer, &mut rng), uniform(&mut rng, B));
        let weights = LossWeights {
            symmetry: 0.7,
            ..WEIGHTS
        };
        let run = |indices: &[usize], ends: &[usize]| {
            let minibatch = Minibatch {
                buffer: &buffer,
                actions: &actions,
                returns: &returns,
                indices,
                advantages: &[0.0; B],
                weights,
                moved: Some(&moved),
            };
            let (mut sum, mut gradient) = (0.0, vec![0.0; params.len()]);
            let mut workspace = network.workspace(B);
            let mut from = 0;
            for &end in ends {
                let chunk = from..end;
                from = end;
                let sums = minibatch.chunk(&network, &params, chunk, &mut workspace, &mut gradient);
                sum += sums.symmetry;
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
    fn before_the_first_step_the_ratio_is_one() {
        let network = network(Group::D2, strided(), JOINT);
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let params = network.init(&mut rng);
        let buffer = rollout(&network, &params, 0.0, &mut rng);
        let (sums, _) = loss(&network, &params, &buffer, &[0.0; B]);
        // with a ratio of one, the surrogate is the negated sum of the advantages, here 0
        assert!(
            sums.policy.abs() < 1e-6 && sums.kl.abs() < 1e-12 && sums.clipped == 0.0,
            "{sums:?}"
        );
    }

    #[test]
    fn advantages_are_normalised_within_the_minibatch() {
        let mut out = Vec::new();
        normalised_advantages(&[9.0, 1.0, 3.0, 5.0], &[1, 2, 3], &mut out);
        for (a, expected) in out.iter().zip([-1.0, 0.0, 1.0]) {
            assert!((a - expected).abs() < 1e-7);
        }
        normalised_advantages(&[9.0], &[0], &mut out);
        assert_eq!(out, [0.0]);
    }
}
