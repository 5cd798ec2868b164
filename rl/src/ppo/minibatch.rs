//! Minibatches of a PPO update, and the devices that compute their losses and gradients.

use std::ops::Range;

use equivariant::{ParallelChunks, Scalar};
use rand_chacha::ChaCha8Rng;

use crate::adam::{Adam, ParamGroup};
use crate::buffer::RolloutBuffer;
use crate::distributions::ActionDistribution;
use crate::error::{RlError, check_finite};
use crate::network::{ActorCritic, ActorCriticWorkspace};
use crate::network_policy::ActorCriticPolicy;
use crate::ppo::settings::PpoSettings;
use crate::ppo::stats::{LossSums, LossWeights, PpoTotals};
use crate::ppo::symmetry_loss::{AugmentedSamples, symmetry_loss};
use crate::ranks::ProcessRanks;

/// Number of decisions that one thread processes at a time (a chunk) in training. A minibatch of 64
/// then has 8 chunks to keep the cores busy; smaller chunks take a quarter more time.
const TRAINING_CHUNK: usize = 8;

/// Cap of the logarithm of the probability ratio of new and old policy, so that sums over a
/// minibatch stay finite in f32 (e^60 is about 1e26). A single decision at the cap puts the KL
/// estimate above any limit, which ends the update before a step on it.
pub(super) const MAX_LOG_RATIO: f64 = 60.0;

/// A device, CPU or GPU, that computes losses and gradients of the minibatches of a PPO update.
pub(super) trait Backend: Send + Sync {
    /// Returns the summed losses of a minibatch and the gradient of their mean with respect to the
    /// parameters; `None` if the device queues the minibatch and takes its step itself.
    ///
    /// # Errors
    /// [`RlError::NotFinite`] for a loss that is infinite or NaN.
    fn losses(
        &mut self,
        update: &Update,
        minibatch: &Minibatch,
    ) -> Result<Option<(LossSums, &mut [f32])>, RlError>;

    /// Finishes queued minibatches and writes the results to policy, optimiser and random
    /// generator; `None` if the device does not queue.
    ///
    /// # Errors
    /// [`RlError::NotFinite`] for a loss or a gradient that is infinite or NaN, and errors of the
    /// device.
    fn finish(&mut self, update: &mut Update) -> Result<Option<PpoTotals>, RlError>;
}

/// Inputs and state of a PPO update in progress.
pub(super) struct Update<'a> {
    pub settings: &'a PpoSettings,
    /// Factor of the learning rates in this update, see [`PpoSettings::schedule`].
    pub rate_factor: f32,
    pub optimiser: &'a mut Adam,
    pub batch: &'a TrainingBatch,
    pub policy: &'a mut ActorCriticPolicy,
    pub buffer: &'a RolloutBuffer,
    pub rng: &'a mut ChaCha8Rng,
}

/// Advantages, returns and actions of a rollout of T steps of N environments, `[T, N, ...]` each;
/// kept between updates to reuse the allocations.
#[derive(Default)]
pub(super) struct TrainingBatch {
    pub advantages: Vec<f32>,
    pub returns: Vec<f32>,
    pub actions: Vec<f64>,
    /// Transformed samples of the rollout for a
    /// [`SymmetryLossSettings`](crate::SymmetryLossSettings); not kept between updates.
    pub augmented: Option<AugmentedSamples>,
}

impl<'a> Update<'a> {
    /// Returns the two parameter groups of the optimiser, image encoder and all others, with their
    /// learning rates. The encoder has its own rate, since its changes under the critic's loss move
    /// the actor, too.
    pub fn param_groups(&self) -> [ParamGroup; 2] {
        let group = |range, rate: f32| ParamGroup { range, learning_rate: rate * self.rate_factor };
        let (network, settings) = (self.policy.network(), self.settings);
        [
            group(network.encoder_param_range(), settings.encoder_learning_rate),
            group(network.non_encoder_param_range(), settings.head_learning_rate),
        ]
    }

    /// Returns the minibatch of the decisions at `indices`; `advantages` holds one value for each
    /// of them, which the caller has normalised.
    pub fn minibatch<'b>(&self, indices: &'b [usize], advantages: &'b [f64]) -> Minibatch<'b>
    where
        'a: 'b,
    {
        let (settings, batch) = (self.settings, self.batch);
        let symmetry = settings.symmetry;
        Minibatch {
            buffer: self.buffer,
            actions: &batch.actions,
            returns: &batch.returns,
            indices,
            advantages,
            weights: LossWeights {
                clip_coef: settings.clip.into(),
                vf_coef: settings.value_weight.into(),
                ent_coef: settings.entropy_weight.into(),
                symmetry: symmetry.map_or(0.0, |symmetry| symmetry.weight.into()),
            },
            augmented: batch.augmented.as_ref(),
        }
    }
}

/// One recorded decision of a rollout: action, log-probability, advantage and return.
#[derive(Clone, Copy, Debug)]
pub(super) struct Decision<'a> {
    /// Action that was executed, `[A]`.
    pub action: &'a [f64],
    /// Log-probability of the action under the collecting policy.
    pub log_prob: f64,
    /// Advantage of the action, normalised over the minibatch.
    pub advantage: f64,
    /// Return of the decision, the target of the value function.
    pub ret: f64,
}

/// Output of the current network for the observation of a decision.
#[derive(Clone, Copy, Debug)]
pub(super) struct NetworkOutput<'a> {
    /// Action distribution of the policy in training.
    pub distribution: ActionDistribution<'a>,
    /// State value V(s) by the critic in training.
    pub value: f64,
}

/// A minibatch of B decisions of a rollout, as input of one gradient step of PPO.
#[derive(Clone, Copy, Debug)]
pub(super) struct Minibatch<'a> {
    pub buffer: &'a RolloutBuffer,
    /// Actions of the whole rollout, `[T, N, A]`.
    pub actions: &'a [f64],
    /// GAE returns of the whole rollout, `[T, N]`.
    pub returns: &'a [f32],
    /// Indices of the minibatch's decisions in the rollout, `[B]`.
    pub indices: &'a [usize],
    /// Normalised advantages of the minibatch's decisions, `[B]`.
    pub advantages: &'a [f64],
    pub weights: LossWeights,
    /// Transformed samples of the rollout; `None` without a symmetry loss.
    pub augmented: Option<&'a AugmentedSamples>,
}

impl Minibatch<'_> {
    /// Adds the share that the decisions at positions `range` of the minibatch have in the gradient
    /// of its mean loss to `gradient`, and returns the sums of their loss terms.
    pub fn accumulate_chunk_gradients<T: Scalar>(
        &self,
        network: &ActorCritic<T>,
        params: &[T],
        range: Range<usize>,
        workspace: &mut ActorCriticWorkspace<T>,
        gradient: &mut [T],
    ) -> LossSums {
        for (slot, &i) in self.indices[range.clone()].iter().enumerate() {
            let (image, vector) =
                self.buffer.observations().image_and_vector(self.buffer.spec(), i);
            network.load_observation(slot, image, vector, workspace);
        }
        network.forward(params, range.len(), workspace);
        let mut sums = self.loss(range.clone(), workspace);
        network.backward(params, range.len(), workspace, gradient);
        if let Some(augmented) = self.augmented {
            // a second pass in the same workspace, after the gradient of the first one was added
            let scale = 1.0 / self.indices.len() as f64;
            let indices = &self.indices[range];
            augmented.forward(network, params, indices, workspace);
            sums.symmetry_loss = symmetry_loss(indices.len(), &self.weights, scale, workspace);
            network.backward(params, indices.len(), workspace, gradient);
        }
        sums
    }

    /// Sums the loss terms of the decisions at positions `range`, and writes the gradients with
    /// respect to the network's outputs to the workspace.
    fn loss<T>(&self, range: Range<usize>, w: &mut ActorCriticWorkspace<T>) -> LossSums {
        let width = w.log_std.len();
        // the mean is over the whole minibatch, not the chunk: chunk gradients are only added
        let scale = 1.0 / self.indices.len() as f64;
        let mut sums = LossSums::default();
        w.d_log_std.fill(0.0);
        for (slot, position) in range.enumerate() {
            let (i, own) = (self.indices[position], slot * width..(slot + 1) * width);
            let old = Decision {
                action: &self.actions[i * width..(i + 1) * width],
                log_prob: f64::from(self.buffer.decisions().log_probs[i]),
                advantage: self.advantages[position],
                ret: f64::from(self.returns[i]),
            };
            let new = NetworkOutput {
                distribution: ActionDistribution {
                    mean: &w.mean[own.clone()],
                    log_std: &w.log_std,
                    choices: &self.buffer.spec().choices,
                },
                value: w.value[slot],
            };
            let (d_mean, d_log_std) = (&mut w.d_mean[own], &mut w.d_log_std);
            let (terms, d_value) = self.weights.loss(&old, &new, scale, d_mean, d_log_std);
            w.d_value[slot] = d_value;
            sums.add_sums(&terms);
        }
        sums
    }
}

/// The CPU as a [`Backend`]: chunks run in parallel, and their gradients are added in a fixed
/// order.
pub(super) struct CpuBackend {
    chunks: ParallelChunks<f32, ActorCriticWorkspace<f32>>,
    gradient: Vec<f32>,
    ranks: ProcessRanks,
}

impl CpuBackend {
    pub fn new(policy: &ActorCriticPolicy, ranks: ProcessRanks) -> Self {
        let network = policy.network().clone();
        let num_params = network.num_params();
        Self {
            chunks: ParallelChunks::new(num_params, TRAINING_CHUNK, move || {
                network.new_workspace(TRAINING_CHUNK)
            }),
            gradient: vec![0.0; num_params],
            ranks,
        }
    }
}

impl Backend for CpuBackend {
    fn losses(
        &mut self,
        update: &Update,
        minibatch: &Minibatch,
    ) -> Result<Option<(LossSums, &mut [f32])>, RlError> {
        let (network, params) = (update.policy.network(), update.policy.params());
        let (samples, mut losses) = (minibatch.indices.len(), LossSums::default());
        self.gradient.fill(0.0);
        let chunk_losses = self.ranks.accumulate_gradients(
            &mut self.chunks,
            samples,
            &mut self.gradient,
            |range, workspace, gradient| {
                minibatch
                    .accumulate_chunk_gradients(network, params, range, workspace, gradient)
                    .sums_to_array()
            },
        );
        chunk_losses
            .into_iter()
            .for_each(|chunk| losses.add_sums(&LossSums::sums_from_array(chunk)));
        let sum = losses.policy_loss + losses.value_loss + losses.approx_kl + losses.symmetry_loss;
        check_finite("the loss of a minibatch", sum)?;
        Ok(Some((losses, &mut self.gradient)))
    }

    fn finish(&mut self, _: &mut Update) -> Result<Option<PpoTotals>, RlError> {
        Ok(None)
    }
}
