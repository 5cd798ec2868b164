//! Updates on the processor.

use equivariant::Chunks;

use crate::actor_critic_policy::ActorCriticPolicy;
use crate::adam::clip_global_norm;
use crate::error::{RlError, check_finite};
use crate::loss::{LossSums, LossWeights};
use crate::minibatch::{Minibatch, normalised_advantages};
use crate::pass::Workspace;
use crate::ppo::task::{Task, shuffle};
use crate::ppo_settings::PpoSettings;
use crate::ppo_stats::Totals;

/// Samples of one training chunk: 8 chunks a minibatch keep the cores busy; smaller ones cost a
/// quarter more time.
const TRAINING_CHUNK: usize = 8;

/// Memory for gradients and minibatches.
pub(super) struct Processor {
    chunks: Chunks<f32, Workspace<f32>>,
    gradient: Vec<f32>,
    /// The order in which a pass goes through the rollout.
    order: Vec<usize>,
    /// Advantages of a minibatch.
    normalised: Vec<f64>,
}

impl Processor {
    pub fn new(policy: &ActorCriticPolicy) -> Self {
        let network = policy.network().clone();
        let num_params = network.num_params();
        Self {
            chunks: Chunks::new(num_params, TRAINING_CHUNK, move || {
                network.workspace(TRAINING_CHUNK)
            }),
            gradient: vec![0.0; num_params],
            order: Vec::new(),
            normalised: Vec::new(),
        }
    }

    pub fn run(&mut self, mut task: Task) -> Result<Totals, RlError> {
        let mut totals = Totals::default();
        self.order.clear();
        self.order.extend(0..task.buffer.samples());
        while totals.epochs < task.settings.epochs && self.pass(&mut task, &mut totals)? {
            totals.epochs += 1;
        }
        Ok(totals)
    }

    /// One pass over the rollout in a new order; false when the KL divergence ended it early.
    fn pass(&mut self, task: &mut Task, totals: &mut Totals) -> Result<bool, RlError> {
        shuffle(&mut self.order, task.rng);
        for start in (0..task.buffer.samples()).step_by(task.settings.minibatch) {
            let sums = self.minibatch_gradient(task, start)?;
            totals.losses.add(&sums);
            if sums.kl / sums.samples > task.settings.kl_stop() {
                return Ok(false);
            }
            totals.grad_norms += self.descend(task)?;
            totals.steps += 1;
        }
        Ok(true)
    }

    /// Leaves the gradient of the minibatch that starts at position `start` of the order in
    /// `self.gradient`.
    fn minibatch_gradient(&mut self, task: &Task, start: usize) -> Result<LossSums, RlError> {
        let rollout = &*task.rollout;
        let end = task.buffer.samples().min(start + task.settings.minibatch);
        let indices = &self.order[start..end];
        normalised_advantages(&rollout.advantages, indices, &mut self.normalised);
        let minibatch = Minibatch {
            buffer: task.buffer,
            actions: &rollout.actions,
            returns: &rollout.returns,
            indices,
            advantages: &self.normalised,
            weights: loss_weights(task.settings),
            moved: rollout.moved.as_ref(),
        };
        self.gradient.fill(0.0);
        let (network, params) = (task.policy.network(), task.policy.params());
        let mut sums = LossSums::default();
        let parts = self.chunks.accumulate(
            indices.len(),
            &mut self.gradient,
            |range, workspace, gradient| {
                minibatch.chunk(network, params, range, workspace, gradient)
            },
        );
        parts.iter().for_each(|part| sums.add(part));
        check_finite(
            "the loss of a minibatch",
            sums.policy + sums.value + sums.kl + sums.symmetry,
        )?;
        Ok(sums)
    }

    /// Clips the gradient, takes a step and keeps exploration above its floor; returns the norm
    /// before clipping.
    fn descend(&mut self, task: &mut Task) -> Result<f64, RlError> {
        let norm = clip_global_norm(&mut self.gradient, task.settings.max_grad_norm);
        check_finite("the norm of the gradient", norm)?;
        let (groups, params) = (task.groups(), task.policy.params_mut());
        task.optimiser.step(&groups, params, &self.gradient);
        task.policy.raise_log_std(task.settings.min_log_std);
        Ok(norm)
    }
}

fn loss_weights(settings: &PpoSettings) -> LossWeights {
    LossWeights {
        clip: settings.clip.into(),
        value: settings.value_weight.into(),
        entropy: settings.entropy_weight.into(),
        symmetry: settings
            .symmetry
            .map_or(0.0, |symmetry| symmetry.weight.into()),
    }
}
