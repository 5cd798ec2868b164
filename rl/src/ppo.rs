//! Proximal policy optimisation: one update of a policy from one rollout.
//!
//! Names and order follow CleanRL's `ppo_continuous_action.py` where both compute the same. The
//! rollout comes with bootstrapped values; `gae.rs` computes advantages, `ppo/minibatch.rs` the
//! forward and backward pass of a minibatch, and `ppo/settings.rs` has the hyper-parameters.

#[cfg(feature = "wgpu")]
mod gpu;
mod minibatch;
pub(crate) mod settings;
pub(crate) mod stats;
pub(crate) mod symmetry_loss;
#[cfg(test)]
mod tests;

use std::fmt;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::adam::{Adam, SECOND_MOMENT_NAME, clip_global_norm};
use crate::algorithm::{Algorithm, AlgorithmState, check_not_negative};
use crate::buffer::RolloutBuffer;
use crate::error::{RlError, check_all_finite, check_finite, check_params_fit_network};
use crate::network_policy::ActorCriticPolicy;
use crate::ppo::minibatch::{
    Backend, CpuBackend, Decision, MAX_LOG_RATIO, NetworkOutput, TrainingBatch, Update,
};
use crate::ppo::settings::PpoSettings;
use crate::ppo::stats::{LossSums, LossWeights, PpoStats, PpoTotals};
use crate::ranks::ProcessRanks;

/// Proximal policy optimisation (Schulman et al., arXiv 1707.06347, algorithm 1) with the optimiser
/// state of one policy.
pub struct Ppo {
    settings: PpoSettings,
    optimiser: Adam,
    backend: Box<dyn Backend>,
    batch: TrainingBatch,
}

impl Ppo {
    /// Creates PPO with fresh optimiser state, which trains `policy` or its clones on the CPU.
    ///
    /// # Errors
    /// [`RlError::InvalidSetting`] if a setting is out of range, [`RlError::LogStdBelowMinimum`] if
    /// a log_std of `policy` is already below [`PpoSettings::min_log_std`].
    pub fn new(settings: PpoSettings, policy: &ActorCriticPolicy) -> Result<Self, RlError> {
        Self::on_ranks(settings, policy, ProcessRanks::default())
    }

    /// Creates PPO as [`Ppo::new`] does, for several processes (`ranks`) that each compute a share
    /// of every minibatch and all make the same updates.
    ///
    /// # Errors
    /// Errors of [`Ppo::new`].
    pub fn on_ranks(
        settings: PpoSettings,
        policy: &ActorCriticPolicy,
        ranks: ProcessRanks,
    ) -> Result<Self, RlError> {
        Self::on(settings, policy, Box::new(CpuBackend::new(policy, ranks)))
    }

    /// Creates PPO with fresh optimiser state, which trains `policy` or its clones on a GPU:
    /// passes, losses and optimiser steps, one command buffer for each minibatch; results are read
    /// once in an update. The CPU draws the order of the minibatches and holds the optimiser's
    /// state after each update, so updates on CPU and GPU can alternate.
    ///
    /// # Errors
    /// Errors of [`Ppo::new`], and [`RlError::UnsupportedOnGpu`] for a
    /// [`SymmetryLossSettings`](crate::SymmetryLossSettings).
    #[cfg(feature = "wgpu")]
    pub fn on_device(
        settings: PpoSettings,
        policy: &ActorCriticPolicy,
        device: &equivariant::gpu::GpuDevice,
    ) -> Result<Self, RlError> {
        if settings.symmetry.is_some() {
            return Err(RlError::UnsupportedOnGpu);
        }
        policy.network().spec().require_continuous("an update on a GPU")?;
        Self::on(settings, policy, Box::new(gpu::GpuBackend::new(device)))
    }

    fn on(
        settings: PpoSettings,
        policy: &ActorCriticPolicy,
        backend: Box<dyn Backend>,
    ) -> Result<Self, RlError> {
        settings.check()?;
        if settings.symmetry.is_some() {
            policy.network().spec().require_continuous("a symmetry loss")?;
        }
        settings.check_min_log_std(policy.log_std())?;
        Ok(Self {
            optimiser: Adam::new(policy.network().num_params(), settings.adam_epsilon),
            settings,
            backend,
            batch: TrainingBatch::default(),
        })
    }

    /// Returns the settings of PPO.
    pub fn settings(&self) -> &PpoSettings {
        &self.settings
    }
}

impl Algorithm for Ppo {
    type Policy = ActorCriticPolicy;
    type Experience = RolloutBuffer;
    type Stats = PpoStats;

    /// Trains `policy` in several passes over the minibatches of a finished rollout. `rng` gives
    /// the group elements of a [`SymmetryLossSettings`](crate::SymmetryLossSettings), then the
    /// order of the minibatches. The same inputs give the same bits on any number of threads.
    ///
    /// The update stops before the first gradient step whose minibatch has a KL divergence above
    /// [`PpoSettings::kl_stop_threshold`] (Stable-Baselines3, `PPO.train`).
    ///
    /// # Errors
    /// [`RlError::BufferNotFinished`] for an unfinished rollout, and errors of
    /// [`Algorithm::update`]; returns, the loss and the gradient are checked for divergence.
    fn update(
        &mut self,
        policy: &mut ActorCriticPolicy,
        buffer: &RolloutBuffer,
        rng: &mut ChaCha8Rng,
    ) -> Result<PpoStats, RlError> {
        check_params_fit_network(self.optimiser.first_moment.len(), policy.params().len())?;
        policy.network().spec().check_compatible(buffer.spec())?;
        self.batch.fill(&self.settings, buffer, rng)?;
        let mut update = Update {
            settings: &self.settings,
            rate_factor: self.settings.schedule.factor(self.optimiser.steps),
            optimiser: &mut self.optimiser,
            batch: &self.batch,
            policy,
            buffer,
            rng,
        };
        let totals = run_epochs(&mut update, &mut *self.backend)?;
        check_all_finite("a parameter after the update", policy.params())?;
        let values = &buffer.decisions().values;
        let augmented = self.batch.augmented.take();
        Ok(PpoStats {
            symmetry_loss: augmented.map(|_| totals.losses.symmetry_loss / totals.losses.samples),
            ..totals.stats(values, &self.batch.returns, policy.log_std())
        })
    }

    /// Returns both moments of Adam and its number of steps.
    fn save(&self) -> AlgorithmState<'_> {
        self.optimiser.save()
    }

    fn restore(&mut self, state: &AlgorithmState<'_>) -> Result<(), RlError> {
        state.check_same_layout(&self.save())?;
        check_not_negative(state, &[SECOND_MOMENT_NAME])?;
        self.optimiser.restore(state);
        Ok(())
    }
}

impl TrainingBatch {
    /// Computes advantages and returns of the rollout in `buffer`, and transforms its observations
    /// by group elements from `rng` if there is a symmetry loss.
    fn fill(
        &mut self,
        settings: &PpoSettings,
        buffer: &RolloutBuffer,
        rng: &mut ChaCha8Rng,
    ) -> Result<(), RlError> {
        let (advantages, returns) = (&mut self.advantages, &mut self.returns);
        advantages.resize(buffer.num_samples(), 0.0);
        returns.resize(buffer.num_samples(), 0.0);
        buffer.write_advantages_and_returns(
            settings.gamma,
            settings.lambda,
            advantages,
            returns,
        )?;
        check_all_finite("a return", returns)?;
        self.actions.clear();
        self.actions.extend(buffer.decisions().actions.iter().map(|&a| f64::from(a)));
        self.augmented = settings.symmetry.map(|symmetry| symmetry.augment(buffer, rng));
        Ok(())
    }
}

/// Runs all epochs of an update over the minibatches, or up to the minibatch whose KL divergence
/// stops it. A GPU, which queues minibatches, applies the same rules itself and reports at the end.
fn run_epochs(update: &mut Update, backend: &mut dyn Backend) -> Result<PpoTotals, RlError> {
    let settings = update.settings;
    let mut totals = PpoTotals::default();
    // indices into the batch and, below, the minibatch: the names are CleanRL's
    let mut b_inds: Vec<usize> = (0..update.buffer.num_samples()).collect();
    let mut mb_advantages = Vec::new();
    'epochs: for _ in 0..settings.epochs {
        shuffle(&mut b_inds, update.rng);
        for mb_inds in b_inds.chunks(settings.minibatch) {
            normalise(&update.batch.advantages, mb_inds, &mut mb_advantages);
            let minibatch = update.minibatch(mb_inds, &mb_advantages);
            // `None`: queued on a GPU
            let Some((losses, gradient)) = backend.losses(update, &minibatch)? else {
                continue;
            };
            // counted even if the minibatch stops the update, whose statistics should show why
            totals.losses.add_sums(&losses);
            let approx_kl = losses.approx_kl / losses.samples;
            if approx_kl > settings.kl_stop_threshold() {
                break 'epochs;
            }
            let grad_norm = clip_global_norm(gradient, settings.max_grad_norm);
            check_finite("the norm of the gradient", grad_norm)?;
            let (groups, params) = (update.param_groups(), update.policy.params_mut());
            update.optimiser.step(&groups, params, gradient);
            // after each step, so that no minibatch sees a standard deviation below the floor
            update.policy.clamp_log_std(settings.min_log_std);
            totals.grad_norm_sum += grad_norm;
            totals.steps += 1;
        }
        totals.epochs += 1;
    }
    Ok(backend.finish(update)?.unwrap_or(totals))
}

/// Shuffles the indices of decisions by the Fisher-Yates method (Durstenfeld, Comm. ACM 7, 1964,
/// algorithm 235).
fn shuffle(b_inds: &mut [usize], rng: &mut ChaCha8Rng) {
    for i in (1..b_inds.len()).rev() {
        b_inds.swap(i, rng.random_range(0..=i));
    }
}

/// Writes the advantages of a minibatch, those at indices `mb_inds`, normalised to mean 0 and
/// sample standard deviation 1.
///
/// Normalisation is per minibatch, as in Stable-Baselines3 (`PPO.train`) and detail 7 of "The 37
/// implementation details of PPO" (Huang et al., ICLR blog track 2022).
fn normalise(advantages: &[f32], mb_inds: &[usize], out: &mut Vec<f64>) {
    out.clear();
    out.extend(mb_inds.iter().map(|&i| f64::from(advantages[i])));
    let count = out.len() as f64;
    let mean = out.iter().sum::<f64>() / count;
    let squares = out.iter().map(|a| (a - mean).powi(2)).sum::<f64>();
    // a rollout's last minibatch may have a single decision
    let std = (squares / (count - 1.0).max(1.0)).sqrt();
    out.iter_mut().for_each(|a| *a = (*a - mean) / (std + 1e-8));
}

impl LossWeights {
    /// Returns the loss terms of one decision and the gradient with respect to the value. Writes
    /// the gradient with respect to the mean to `d_mean` and adds the gradient with respect to
    /// log_std to `d_log_std`; all gradients are multiplied by `scale` (1 / minibatch).
    ///
    /// Schulman et al., "Proximal policy optimization algorithms" (arXiv 1707.06347), equations 7
    /// and 9, without value clipping. The KL estimator is k3 of Schulman, "Approximating KL
    /// divergence" (2020): (r - 1) - ln r.
    fn loss(
        &self,
        old: &Decision,
        new: &NetworkOutput,
        scale: f64,
        d_mean: &mut [f64],
        d_log_std: &mut [f64],
    ) -> (LossSums, f64) {
        let logratio = new.distribution.log_prob(old.action) - old.log_prob;
        // a cap instead of an infinity, so that sums over the minibatch stay finite
        let capped = logratio > MAX_LOG_RATIO;
        let ratio = if capped { MAX_LOG_RATIO } else { logratio }.exp();
        let clip_coef = self.clip_coef;
        let pg_loss1 = -(ratio * old.advantage);
        let pg_loss2 = -(ratio.clamp(1.0 - clip_coef, 1.0 + clip_coef) * old.advantage);
        // where the maximum takes the clipped branch, the loss does not depend on the policy
        let unclipped = pg_loss1 >= pg_loss2;
        let d_log_prob = if unclipped { pg_loss1 * scale } else { 0.0 };
        let d_entropy = -self.ent_coef * scale;
        new.distribution.backward(old.action, d_log_prob, d_entropy, d_mean, d_log_std);
        // squared without the factor 1/2, so the gradient below has a factor 2 (equation 9)
        let error = new.value - old.ret;
        let terms = LossSums {
            samples: 1.0,
            policy_loss: pg_loss1.max(pg_loss2),
            value_loss: error * error,
            entropy: new.distribution.entropy(),
            approx_kl: (ratio - 1.0) - logratio,
            clip_fraction: f64::from(u8::from((ratio - 1.0).abs() > clip_coef)),
            symmetry_loss: 0.0,
        };
        (terms, 2.0 * self.vf_coef * error * scale)
    }
}

impl fmt::Debug for Ppo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Ppo")
            .field("settings", &self.settings)
            .field("steps", &self.optimiser.steps)
            .finish_non_exhaustive()
    }
}
