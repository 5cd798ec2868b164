//! A loss that pulls a policy towards a symmetry that its network lacks.

use equivariant::Scalar;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use symmetry::{D2, Group};

use crate::buffer::RolloutBuffer;
use crate::env::{EnvSpec, Observations};
use crate::error::{RlError, require, require_weight};
use crate::network::{ActorCritic, ActorCriticWorkspace};
use crate::ppo::stats::LossWeights;

/// Settings of a loss for a policy whose outputs break a symmetry: the regularisers of
/// data-regularised actor-critic (DrAC; Raileanu et al., "Automatic data augmentation for
/// generalization in deep reinforcement learning", NeurIPS 2021, equations 3 to 5), for
/// transformations that act on actions, too. The PPO surrogate uses only untransformed samples, so
/// it stays an estimate of the policy's own gradient.
///
/// For a decision with mean m and value v and a group element g, with m' and v' for the transformed
/// observation, it is `weight * (sum((m' - g m)^2 / (2 sigma^2)) + value_weight * (v' - v)^2)`. The
/// first term is the KL divergence between the action distribution for the transformed observation
/// and the transformed distribution; m, v and sigma are constants in it. The loss of an equivariant
/// policy is 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SymmetryLossSettings {
    /// Symmetry group that the loss draws transformations from, any but C1. One element other than
    /// the identity is drawn for each decision and update.
    pub group: Group,
    /// Weight of the symmetry loss in the total loss, at least 0.
    pub weight: f32,
}

impl Default for SymmetryLossSettings {
    /// Returns D2 with a weight of 0.1, from the paper's table of hyper-parameters.
    fn default() -> Self {
        Self { group: Group::D2, weight: 0.1 }
    }
}

impl SymmetryLossSettings {
    pub(super) fn check(&self) -> Result<(), RlError> {
        let order = self.group.order();
        require(
            "the order of symmetry.group",
            order as f32,
            "2 or 4 (D1x, D1y, C2 or D2); leave `symmetry` out to have no such loss",
            order > 1,
        )?;
        require_weight("symmetry.weight", self.weight)
    }

    /// Draws a random group element for each decision of the rollout and transforms the decision's
    /// observation by it.
    pub(super) fn augment(&self, buffer: &RolloutBuffer, rng: &mut ChaCha8Rng) -> AugmentedSamples {
        // the identity comes first
        let others = &self.group.elements()[1..];
        let draw = |_| others[rng.random_range(0..others.len())];
        let elements: Vec<D2> = (0..buffer.num_samples()).map(draw).collect();
        let mut observations = buffer.observations().clone();
        for (i, &g) in elements.iter().enumerate() {
            observations.transform(buffer.spec(), i, g);
        }
        AugmentedSamples { elements, observations }
    }
}

/// Observations of a rollout, each transformed by its own group element.
#[derive(Debug)]
pub(super) struct AugmentedSamples {
    elements: Vec<D2>,
    observations: Observations,
}

impl AugmentedSamples {
    /// Stores the outputs of the last forward pass, over the original observations, transformed in
    /// `d_mean` and `d_value` as targets, then runs the network forward on the transformed
    /// observations at `indices`.
    pub fn forward<T: Scalar>(
        &self,
        network: &ActorCritic<T>,
        params: &[T],
        indices: &[usize],
        w: &mut ActorCriticWorkspace<T>,
    ) {
        self.store_targets(network.spec(), indices, w);
        for (slot, &i) in indices.iter().enumerate() {
            let (image, vector) = self.observations.image_and_vector(network.spec(), i);
            network.load_observation(slot, image, vector, w);
        }
        network.forward(params, indices.len(), w);
    }

    /// Stores the targets of the transformed samples in `d_mean` and `d_value`, which a forward
    /// pass does not write: the last pass's means, transformed, and its values.
    fn store_targets<T>(&self, spec: &EnvSpec, indices: &[usize], w: &mut ActorCriticWorkspace<T>) {
        let width = spec.action_irreps.len();
        for (slot, &i) in indices.iter().enumerate() {
            for (a, irrep) in spec.action_irreps.iter().enumerate() {
                let own = slot * width + a;
                w.d_mean[own] = f64::from(irrep.sign(self.elements[i])) * w.mean[own];
            }
            w.d_value[slot] = w.value[slot];
        }
    }
}

/// Returns the summed, unweighted symmetry loss of n transformed samples, and replaces the targets
/// in `d_mean` and `d_value` by the gradient of the loss, times its weight and `scale`.
pub(super) fn symmetry_loss<T>(
    n: usize,
    weights: &LossWeights,
    scale: f64,
    w: &mut ActorCriticWorkspace<T>,
) -> f64 {
    let width = w.log_std.len();
    let scale = weights.symmetry * scale;
    let mut loss = 0.0;
    // standard deviations are constants of this loss, unlike in the paper
    w.d_log_std.fill(0.0);
    for slot in 0..n {
        for a in 0..width {
            let own = slot * width + a;
            let (off, precision) = (w.mean[own] - w.d_mean[own], (-2.0 * w.log_std[a]).exp());
            loss += off * off * precision / 2.0;
            w.d_mean[own] = scale * off * precision;
        }
        let off = w.value[slot] - w.d_value[slot];
        loss += weights.vf_coef * off * off;
        w.d_value[slot] = 2.0 * scale * weights.vf_coef * off;
    }
    loss
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;
    use crate::env::Transition;
    use crate::fixtures;
    use crate::fixtures::{central_difference, strided};
    use crate::network_settings::{CriticSettings, NetworkSettings};
    use crate::policy::Decisions;

    const B: usize = 12;
    const WEIGHTS: LossWeights =
        LossWeights { clip_coef: 0.2, vf_coef: 0.3, ent_coef: 0.0, symmetry: 0.7 };
    const ALL: SymmetryLossSettings = SymmetryLossSettings { group: Group::D2, weight: 0.7 };

    fn spec() -> EnvSpec {
        EnvSpec { num_envs: B, ..fixtures::spec() }
    }

    fn network(group: Group, critic: CriticSettings) -> ActorCritic<f64> {
        let settings = NetworkSettings { critic, ..fixtures::settings(group, strided()) };
        ActorCritic::new(&settings, &spec()).unwrap()
    }

    /// Returns one step of random observations.
    fn buffer() -> RolloutBuffer {
        let (spec, observations) = (spec(), fixtures::observations(B));
        let (decisions, transition) = (Decisions::new(&spec), Transition::new(&spec));
        let mut buffer = RolloutBuffer::new(&spec, 1).unwrap();
        buffer.push(&observations, &decisions, &transition, &[0.0; B]).unwrap();
        buffer
    }

    fn rng() -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(4)
    }

    /// Returns parameters that are not small, a workspace after a pass over the original samples,
    /// and the transformed samples.
    fn observed(
        network: &ActorCritic<f64>,
    ) -> (Vec<f64>, ActorCriticWorkspace<f64>, AugmentedSamples) {
        let (buffer, mut workspace) = (buffer(), network.new_workspace(B));
        let mut params = network.init_params(&mut rng());
        params[network.num_params() - 3..].copy_from_slice(&[-0.3, 0.2, -0.6]);
        for i in 0..B {
            let (image, vector) = buffer.observations().image_and_vector(&spec(), i);
            network.load_observation(i, image, vector, &mut workspace);
        }
        network.forward(&params, B, &mut workspace);
        let augmented = ALL.augment(&buffer, &mut rng());
        (params, workspace, augmented)
    }

    fn loss_of(group: Group, critic: CriticSettings) -> (f64, Vec<f64>) {
        let network = network(group, critic);
        let (params, mut workspace, augmented) = observed(&network);
        let indices: Vec<usize> = (0..B).collect();
        let mut gradient = vec![0.0; params.len()];
        augmented.forward(&network, &params, &indices, &mut workspace);
        let loss = symmetry_loss(B, &WEIGHTS, 1.0, &mut workspace);
        network.backward(&params, B, &mut workspace, &mut gradient);
        (loss, gradient)
    }

    #[test]
    fn an_equivariant_policy_pays_nothing_and_a_plain_one_does() {
        for critic in [CriticSettings::Joint { fields: 3 }, CriticSettings::Pooled { width: 3 }] {
            let (none, flat) = loss_of(Group::D2, critic);
            assert!(none < 1e-20 && flat.iter().all(|g| g.abs() < 1e-9));
            for group in [Group::C1, Group::D1x, Group::C2] {
                let (some, steep) = loss_of(group, critic);
                assert!(some > 1e-6 && steep.iter().any(|g| g.abs() > 1e-6), "{group}");
            }
        }
    }

    /// By hand, with two of three components off: an action along x changes its sign under a flip
    /// of x and a height does not.
    #[test]
    fn the_loss_of_one_decision_by_hand() {
        let network = network(Group::C1, CriticSettings::Joint { fields: 3 });
        let (_, mut w, mut augmented) = observed(&network);
        augmented.elements[0] = D2::FlipX;
        w.mean[..3].copy_from_slice(&[0.5, 0.25, -1.0]);
        w.value[0] = 2.0;
        augmented.store_targets(&spec(), &[0], &mut w);
        w.mean[..3].copy_from_slice(&[-0.25, -0.25, -1.0]);
        w.value[0] = 4.0;
        w.log_std = vec![0.0, -(2f64.ln()), 0.0];
        w.d_log_std.fill(9.0);
        let loss = symmetry_loss(1, &WEIGHTS, 0.5, &mut w);
        assert!((loss - (0.0625 / 2.0 + 0.25 * 4.0 / 2.0 + 0.3 * 4.0)).abs() < 1e-12);
        for (d, by_hand) in w.d_mean.iter().zip([0.25 * 0.35, -2.0 * 0.35, 0.0]) {
            assert!((d - by_hand).abs() < 1e-12, "{:?}", w.d_mean);
        }
        assert!((w.d_value[0] - 0.35 * 2.0 * 0.3 * 2.0).abs() < 1e-12);
        assert_eq!(w.d_log_std, [0.0; 3]);
    }

    #[test]
    fn gradient_equals_finite_differences_with_the_answers_held() {
        for critic in [CriticSettings::Joint { fields: 3 }, CriticSettings::Pooled { width: 3 }] {
            let network = network(Group::C1, critic);
            let (mut params, mut workspace, augmented) = observed(&network);
            let indices: Vec<usize> = (0..B).collect();
            let mut gradient = vec![0.0; params.len()];
            augmented.forward(&network, &params, &indices, &mut workspace);
            let targets = (workspace.d_mean.clone(), workspace.d_value.clone());
            symmetry_loss(B, &WEIGHTS, 0.25, &mut workspace);
            network.backward(&params, B, &mut workspace, &mut gradient);
            let log_std = params.len() - 3;
            for (i, g) in gradient.iter().enumerate() {
                let slope = central_difference(&mut params, i, 1e-6, |params| {
                    augmented.forward(&network, params, &indices, &mut workspace);
                    workspace.d_mean.clone_from(&targets.0);
                    workspace.d_value.clone_from(&targets.1);
                    let loss = symmetry_loss(B, &WEIGHTS, 0.25, &mut workspace);
                    loss * 0.25 * WEIGHTS.symmetry
                });
                // standard deviations are not trained by it
                let expected = if i < log_std { slope } else { 0.0 };
                assert!((expected - g).abs() < 1e-7, "{i}: {g} {slope}");
            }
            assert!(gradient.iter().filter(|g| **g != 0.0).count() > params.len() / 4);
        }
    }

    #[test]
    fn all_elements_but_the_identity_are_drawn_and_move_what_was_observed() {
        let (buffer, spec) = (buffer(), spec());
        let augmented = ALL.augment(&buffer, &mut rng());
        for g in D2::ALL {
            assert_eq!(augmented.elements.contains(&g), g != D2::Identity, "{g}");
        }
        for (i, &g) in augmented.elements.iter().enumerate() {
            let mut expected = buffer.observations().clone();
            expected.transform(&spec, i, g);
            assert_eq!(
                augmented.observations.image_and_vector(&spec, i),
                expected.image_and_vector(&spec, i)
            );
        }
    }
}
