//! Minibatches of an update, and the devices that compute their losses and gradients.

use std::ops::Range;

use equivariant::{Chunks, Scalar};
use rand_chacha::ChaCha8Rng;

use crate::adam::{Adam, ParamGroup};
use crate::buffer::RolloutBuffer;
use crate::error::{RlError, check_finite};
use crate::network::{ActorCritic, Workspace};
use crate::network_policy::ActorCriticPolicy;
use crate::ppo::settings::PpoSettings;
use crate::ppo::stats::{LossSums, LossWeights, Totals};
use crate::ppo::symmetry_loss::{TransformedSamples, symmetry_loss};

/// Samples of one training chunk: 8 chunks a minibatch keep the cores busy; smaller ones cost a
/// quarter more time.
const TRAINING_CHUNK: usize = 8;

/// Logarithm at which a ratio is cut, so that sums over a minibatch stay finite in single
/// precision. One decision beyond it brings the KL estimate past every limit, which ends an update
/// before it learns from that.
pub(super) const MAX_LOG_RATIO: f64 = 60.0;

/// Computes the minibatches of an update.
pub(super) trait Device: Send + Sync {
    /// Returns the losses of a minibatch and their gradient in the parameters; `None` where the
    /// device queues the minibatch and takes its step by itself.
    ///
    /// # Errors
    /// [`RlError::NotFinite`] for a loss that is not a number.
    fn losses(
        &mut self,
        update: &Update,
        minibatch: &Minibatch,
    ) -> Result<Option<(LossSums, &mut [f32])>, RlError>;

    /// Runs what was queued, and leaves policy, optimiser and generator as the steps that were
    /// taken leave them; `None` where nothing was queued.
    ///
    /// # Errors
    /// [`RlError::NotFinite`] for a loss or a gradient that is not a number, and what the device
    /// says.
    fn finish(&mut self, update: &mut Update) -> Result<Option<Totals>, RlError>;
}

/// An update in progress.
pub(super) struct Update<'a> {
    pub settings: &'a PpoSettings,
    pub optimiser: &'a mut Adam,
    pub batch: &'a Batch,
    pub policy: &'a mut ActorCriticPolicy,
    pub buffer: &'a RolloutBuffer,
    pub rng: &'a mut ChaCha8Rng,
}

/// Values that an update derives from its rollout, `[T, N]` each; kept for their memory.
#[derive(Default)]
pub(super) struct Batch {
    pub advantages: Vec<f32>,
    pub returns: Vec<f32>,
    pub actions: Vec<f64>,
    /// Its decisions moved, for the loss of [`SymmetryLoss`](crate::SymmetryLoss); not kept.
    pub transformed: Option<TransformedSamples>,
}

impl<'a> Update<'a> {
    /// Parameters with their learning rates. The encoder is trained at a rate of its own: its drift
    /// under the critic's loss moves the actor, too.
    pub fn groups(&self) -> [ParamGroup; 2] {
        let group = |range, learning_rate| ParamGroup { range, learning_rate };
        let (network, settings) = (self.policy.network(), self.settings);
        [
            group(network.encoder(), settings.encoder_learning_rate),
            group(network.heads(), settings.head_learning_rate),
        ]
    }

    /// The decisions at these indices with their normalised advantages.
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
            transformed: batch.transformed.as_ref(),
        }
    }
}

/// One decision of a rollout, as it was recorded.
#[derive(Clone, Copy, Debug)]
pub(super) struct Decision<'a> {
    /// The action taken, `[A]`.
    pub action: &'a [f64],
    /// Its log-probability when it was taken.
    pub log_prob: f64,
    /// Its normalised advantage.
    pub advantage: f64,
    /// Target of the value function.
    pub ret: f64,
}

/// Output of the network for the decision now.
#[derive(Clone, Copy, Debug)]
pub(super) struct Output<'a> {
    /// Mean action, `[A]`.
    pub mean: &'a [f64],
    /// Logarithms of the standard deviations, `[A]`.
    pub log_std: &'a [f64],
    /// V(s).
    pub value: f64,
}

/// A minibatch of B decisions of a rollout.
#[derive(Clone, Copy, Debug)]
pub(super) struct Minibatch<'a> {
    pub buffer: &'a RolloutBuffer,
    /// Actions of the whole rollout, `[T, N, A]`.
    pub actions: &'a [f64],
    /// Returns of the whole rollout, `[T, N]`.
    pub returns: &'a [f32],
    /// Decisions that belong to the minibatch, `[B]`.
    pub indices: &'a [usize],
    /// Their normalised advantages, `[B]`.
    pub advantages: &'a [f64],
    pub weights: LossWeights,
    /// The decisions of the rollout moved, where broken symmetries cost something.
    pub transformed: Option<&'a TransformedSamples>,
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
        if let Some(transformed) = self.transformed {
            let scale = 1.0 / self.indices.len() as f64;
            let indices = &self.indices[range];
            transformed.forward(network, params, indices, workspace);
            sums.symmetry_loss = symmetry_loss(indices.len(), &self.weights, scale, workspace);
            network.backward(params, indices.len(), workspace, gradient);
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
            let (i, own) = (self.indices[position], slot * width..(slot + 1) * width);
            let old = Decision {
                action: &self.actions[i * width..(i + 1) * width],
                log_prob: f64::from(self.buffer.decisions().log_probs[i]),
                advantage: self.advantages[position],
                ret: f64::from(self.returns[i]),
            };
            let new =
                Output { mean: &w.mean[own.clone()], log_std: &w.log_std, value: w.value[slot] };
            let (d_mean, d_log_std) = (&mut w.d_mean[own], &mut w.d_log_std);
            let (terms, d_value) = self.weights.loss(&old, &new, scale, d_mean, d_log_std);
            w.d_value[slot] = d_value;
            sums.add(&terms);
        }
        sums
    }
}

/// Computes losses and gradients on the processor, in chunks whose gradients are added in their
/// order.
pub(super) struct Cpu {
    chunks: Chunks<f32, Workspace<f32>>,
    gradient: Vec<f32>,
}

impl Cpu {
    pub fn new(policy: &ActorCriticPolicy) -> Self {
        let network = policy.network().clone();
        let num_params = network.num_params();
        Self {
            chunks: Chunks::new(num_params, TRAINING_CHUNK, move || {
                network.workspace(TRAINING_CHUNK)
            }),
            gradient: vec![0.0; num_params],
        }
    }
}

impl Device for Cpu {
    fn losses(
        &mut self,
        update: &Update,
        minibatch: &Minibatch,
    ) -> Result<Option<(LossSums, &mut [f32])>, RlError> {
        let (network, params) = (update.policy.network(), update.policy.params());
        let (samples, mut losses) = (minibatch.indices.len(), LossSums::default());
        self.gradient.fill(0.0);
        let parts =
            self.chunks.accumulate(samples, &mut self.gradient, |range, workspace, gradient| {
                minibatch.chunk(network, params, range, workspace, gradient)
            });
        parts.iter().for_each(|part| losses.add(part));
        let sum = losses.policy_loss + losses.value_loss + losses.approx_kl + losses.symmetry_loss;
        check_finite("the loss of a minibatch", sum)?;
        Ok(Some((losses, &mut self.gradient)))
    }

    fn finish(&mut self, _: &mut Update) -> Result<Option<Totals>, RlError> {
        Ok(None)
    }
}
