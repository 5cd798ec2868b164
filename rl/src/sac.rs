//! Soft actor-critic: updates of a policy from a replay buffer.
//!
//! Names and order follow CleanRL's `sac_continuous_action.py` where both compute the same.

pub(crate) mod context;
#[cfg(test)]
mod gradient_tests;
mod losses;
mod minibatch;
pub(crate) mod network;
pub(crate) mod policy;
pub(crate) mod settings;
pub(crate) mod stats;
#[cfg(test)]
mod update_tests;

use std::fmt;
use std::ops::Range;

use equivariant::{ParallelChunks, Scalar};
use rand_chacha::ChaCha8Rng;

use crate::adam::{Adam, ParamGroup, SECOND_MOMENT_NAME, clip_values, norm};
use crate::algorithm::{Algorithm, AlgorithmState, check_not_negative};
use crate::env::StepOutcome;
use crate::error::{RlError, check_all_finite, check_finite, check_params_fit_network};
use crate::ranks::ProcessRanks;
use crate::replay::ReplayBuffer;
use crate::sac::losses::Losses;
use crate::sac::minibatch::{SacWorkspace, SampledMinibatch, training_chunk};
use crate::sac::network::SacNetwork;
use crate::sac::policy::SacPolicy;
use crate::sac::settings::{EntropyTemperatureSettings, SacSettings};
use crate::sac::stats::{SacStats, SacSums, SacTotals};

// checkpoint names of the state beside the policy's own
const TARGET_PARAMS: &str = "targets";
const TRAINED_PARAMS: &str = "trained";
const TEMPERATURE: &str = "temperature.log";
const TEMPERATURE_FIRST: &str = "temperature.first";
const TEMPERATURE_SECOND: &str = "temperature.second";

/// Soft actor-critic (Haarnoja et al., arXiv 1801.01290, and arXiv 1812.05905, algorithm 1) with
/// the state of one policy: optimiser, target critics and temperature.
///
/// ```text
/// y     = r + gamma (1 - terminated) (min_i Q'_i(s', a') - alpha ln pi(a'|s'))
/// J_Q   = sum_i (Q_i(s, a) - y)^2 / 2                  (1812.05905, equations 5 and 6)
/// J_pi  = alpha ln pi(b|s) - min_i Q_i(s, b)           (1812.05905, equation 9)
/// J_alpha = -alpha ln pi(b|s) - alpha H                (1812.05905, equation 18)
/// ```
///
/// where a' and b are drawn from the actor, Q' are the target critics, and a time-out is not a
/// termination. All gradients of a step are taken at the same parameters, and one Adam optimises
/// actor and critics together. With [`SacSettings::average_rate`] the policy is a moving average of
/// the parameters that are trained.
pub struct Sac {
    settings: SacSettings,
    optimiser: Adam,
    /// Parameters of the target critics.
    target_params: Vec<f32>,
    /// Parameters that gradient steps train, if the policy's are their moving average; otherwise
    /// empty.
    trained_params: Vec<f32>,
    /// Logarithm of the temperature alpha if it is learned; unused if it is fixed.
    log_alpha: [f32; 1],
    alpha_optimiser: Adam,
    chunks: ParallelChunks<f32, SacWorkspace<f32>>,
    gradient: Vec<f32>,
    minibatch: SampledMinibatch,
    ranks: ProcessRanks,
}

impl Sac {
    /// Creates soft actor-critic with fresh optimiser state, which trains `policy` or its clones;
    /// the target critics start equal to the policy's critics. With
    /// [`SacSettings::average_rate`], the trained parameters start equal to the policy's and are
    /// kept here: later changes to the policy's do not reach them.
    ///
    /// # Errors
    /// [`RlError::InvalidSetting`] if a setting is out of range.
    pub fn new(settings: SacSettings, policy: &SacPolicy) -> Result<Self, RlError> {
        Self::on_ranks(settings, policy, ProcessRanks::default())
    }

    /// Creates soft actor-critic as [`Sac::new`] does, whose minibatches are shared by `ranks`,
    /// each of which makes the same updates.
    ///
    /// # Errors
    /// Errors of [`Sac::new`].
    pub fn on_ranks(
        settings: SacSettings,
        policy: &SacPolicy,
        ranks: ProcessRanks,
    ) -> Result<Self, RlError> {
        settings.check()?;
        let chunk = training_chunk(settings.window);
        let network = policy.network().clone();
        let num_params = network.num_params();
        let trained_params = settings.average_rate.map(|_| policy.params().to_vec());
        Ok(Self {
            trained_params: trained_params.unwrap_or_default(),
            optimiser: Adam::new(num_params, settings.adam_epsilon),
            target_params: policy.params()[network.critic_param_range()].to_vec(),
            log_alpha: [settings.temperature.initial().ln()],
            alpha_optimiser: Adam::new(1, settings.adam_epsilon),
            chunks: ParallelChunks::new(num_params, chunk, move || network.new_workspace(chunk)),
            gradient: vec![0.0; num_params],
            minibatch: SampledMinibatch::default(),
            ranks,
            settings,
        })
    }

    /// Returns the settings of soft actor-critic.
    pub fn settings(&self) -> &SacSettings {
        &self.settings
    }

    /// Returns the temperature alpha, the weight of the entropy: fixed, or as learned so far.
    pub fn temperature(&self) -> f64 {
        match self.settings.temperature {
            EntropyTemperatureSettings::Fixed(alpha) => alpha.into(),
            EntropyTemperatureSettings::Learned { .. } => f64::from(self.log_alpha[0]).exp(),
        }
    }

    /// Returns the number of gradient steps that are due after `recorded` steps were ever recorded:
    /// those for all steps after the burn-in, less the gradient steps already taken. So a fresh
    /// `Sac` with a filled replay buffer catches up on all of its steps in the first update, but a
    /// restored one does not, since [`Algorithm::restore`] restores its count.
    pub fn gradient_steps_due(&self, recorded: u64) -> u64 {
        let after = recorded.saturating_sub(self.settings.burn_in);
        let total = after as f64 * f64::from(self.settings.updates_per_step);
        (total as u64).saturating_sub(self.optimiser.steps)
    }

    /// Takes the gradient steps that are due on the parameters in `policy`, which are the trained
    /// ones; `average` is their moving average, or empty without one.
    fn take_steps(
        &mut self,
        policy: &mut SacPolicy,
        average: &mut [f32],
        replay: &ReplayBuffer,
        rng: &mut ChaCha8Rng,
    ) -> Result<SacStats, RlError> {
        let mut totals = SacTotals::default();
        if !replay.is_empty() {
            for _ in 0..self.gradient_steps_due(replay.total_recorded_steps()) {
                self.step(policy, replay, rng, &mut totals)?;
                move_towards(average, policy.params(), self.settings.average_rate.unwrap_or(1.0));
            }
        }
        check_all_finite("a parameter after the update", policy.params())?;
        Ok(totals.stats(self.temperature(), replay.len()))
    }

    /// Takes one gradient step on actor, critics and temperature, and updates the target critics.
    fn step(
        &mut self,
        policy: &mut SacPolicy,
        replay: &ReplayBuffer,
        rng: &mut ChaCha8Rng,
        totals: &mut SacTotals,
    ) -> Result<(), RlError> {
        self.minibatch.sample(&self.settings, replay, rng);
        let sums = self.losses(policy, replay)?;
        totals.grad_norm_sum += self.clip_and_step(policy, totals)?;
        totals.steps += 1;
        totals.sums.add_sums(&sums);
        self.update_alpha(policy, &sums);
        self.update_targets(policy);
        Ok(())
    }

    /// Computes the summed losses of the sampled minibatch, and its gradient in `self.gradient`.
    fn losses(&mut self, policy: &SacPolicy, replay: &ReplayBuffer) -> Result<SacSums, RlError> {
        let losses = Losses {
            network: policy.network(),
            params: policy.params(),
            target_params: &self.target_params,
            replay,
            minibatch: &self.minibatch,
            gamma: self.settings.gamma.into(),
            alpha: self.temperature(),
            cloning_weight: self.settings.cloning_weight.into(),
        };
        self.gradient.fill(0.0);
        let mut sums = SacSums::default();
        let chunk_losses = self.ranks.accumulate_gradients(
            &mut self.chunks,
            self.settings.batch,
            &mut self.gradient,
            |range, workspace, gradient| {
                losses.accumulate_chunk_gradients(range, workspace, gradient).sums_to_array()
            },
        );
        chunk_losses.into_iter().for_each(|chunk| sums.add_sums(&SacSums::sums_from_array(chunk)));
        let loss = sums.critic_loss + sums.actor_loss + sums.cloning_loss;
        check_finite("the loss of a minibatch", loss)?;
        Ok(sums)
    }

    /// Clips the gradient and takes an Adam step; returns the gradient's norm before clipping.
    fn clip_and_step(
        &mut self,
        policy: &mut SacPolicy,
        totals: &mut SacTotals,
    ) -> Result<f64, RlError> {
        let grad_norm = norm(&self.gradient);
        check_finite("the norm of the gradient", grad_norm)?;
        let clipped = clip_values(&mut self.gradient, self.settings.max_gradient);
        totals.clipped += clipped as f64 / self.gradient.len() as f64;
        let groups = self.groups(policy.network());
        self.optimiser.step(&groups, policy.params_mut(), &self.gradient);
        Ok(grad_norm)
    }

    /// Returns the two parameter groups of the optimiser, image encoder and all others, with their
    /// learning rates in the next gradient step.
    fn groups(&self, network: &SacNetwork<f32>) -> [ParamGroup; 2] {
        let encoder = network.trunk.encoder_param_range();
        let heads = encoder.end..network.num_params();
        let SacSettings { learning_rate, encoder_learning_rate, .. } = self.settings;
        let encoder_rate = encoder_learning_rate.unwrap_or(learning_rate);
        [(encoder, encoder_rate), (heads, learning_rate)]
            .map(|(range, learning_rate)| ParamGroup { range, learning_rate })
    }

    /// Takes a gradient step on the temperature's loss J(alpha) = E[-alpha ln pi - alpha H], where
    /// H is the target entropy (1812.05905, equation 18), with respect to ln alpha, so that alpha
    /// stays positive.
    fn update_alpha(&mut self, policy: &SacPolicy, sums: &SacSums) {
        let EntropyTemperatureSettings::Learned { target, .. } = self.settings.temperature else {
            return;
        };
        let target_entropy = f64::from(target) * policy.network().spec().action_irreps.len() as f64;
        let surplus = -sums.log_pi / sums.samples - target_entropy;
        // dJ / d ln alpha = alpha dJ / d alpha
        let gradient = [(self.temperature() * surplus) as f32];
        let group = ParamGroup::of_all_params(1, self.settings.learning_rate);
        let log_alpha = &mut self.log_alpha;
        self.alpha_optimiser.step(&[group], log_alpha, &gradient);
    }

    /// Moves the target critics by a share `tau` towards the critics (1812.05905, algorithm 1).
    fn update_targets(&mut self, policy: &SacPolicy) {
        let critics = &policy.params()[policy.network().critic_param_range()];
        move_towards(&mut self.target_params, critics, self.settings.tau);
    }
}

/// Moves averages by a share `rate` towards the latest values.
fn move_towards(averages: &mut [f32], latest: &[f32], rate: f32) {
    for (average, value) in averages.iter_mut().zip(latest) {
        *average += rate * (value - *average);
    }
}

impl<T: Scalar> Losses<'_, T> {
    /// Writes the targets y of the critics' loss, from target critics and actor at the next
    /// observations.
    fn write_td_targets(&self, range: &Range<usize>, w: &mut SacWorkspace<T>) {
        for (slot, position) in range.clone().enumerate() {
            let (step, _) = self.sampled_step(position);
            let min_qf_next_target = w.min_q_value(slot).1 - self.alpha * w.log_pi[slot];
            // a truncated episode still has a next value, unlike a terminated one
            let continues = f64::from(u8::from(step.outcome() != StepOutcome::Terminated));
            let reward = f64::from(step.reward());
            w.td_targets[slot] = reward + self.gamma * continues * min_qf_next_target;
        }
    }

    /// Sums the critics' loss of n steps, and writes its gradient with respect to their outputs.
    fn critic_loss(&self, n: usize, w: &mut SacWorkspace<T>) -> SacSums {
        let mut sums = SacSums::default();
        for slot in 0..n {
            for qf in &mut w.critics {
                let error = qf.y[slot].to_f64() - w.td_targets[slot];
                sums.critic_loss += 0.5 * error * error;
                // the mean over both critics
                sums.value += 0.5 * qf.y[slot].to_f64();
                qf.dy[slot] = T::from_f64(error * self.step_weight());
            }
        }
        sums
    }

    /// Sums the actor's loss of n steps, and writes its gradient with respect to the critics'
    /// outputs.
    fn actor_loss(&self, n: usize, w: &mut SacWorkspace<T>) -> SacSums {
        let mut sums = SacSums::default();
        for slot in 0..n {
            let (qf, min_qf_pi) = w.min_q_value(slot);
            sums.samples += 1.0;
            sums.actor_loss += self.alpha * w.log_pi[slot] - min_qf_pi;
            sums.log_pi += w.log_pi[slot];
            // only the critic with the smaller value enters the loss
            w.critics[1 - qf].dy[slot] = T::ZERO;
            w.critics[qf].dy[slot] = T::from_f64(-self.step_weight());
        }
        sums
    }
}

impl Algorithm for Sac {
    type Policy = SacPolicy;
    type Experience = ReplayBuffer;
    type Stats = SacStats;

    /// Takes the gradient steps that are due ([`Sac::gradient_steps_due`]), none during the
    /// burn-in. The same inputs give the same bits on any number of threads.
    ///
    /// # Errors
    /// Errors of [`Algorithm::update`]; the loss and the gradient are checked for divergence.
    fn update(
        &mut self,
        policy: &mut SacPolicy,
        replay: &ReplayBuffer,
        rng: &mut ChaCha8Rng,
    ) -> Result<SacStats, RlError> {
        check_params_fit_network(self.gradient.len(), policy.params().len())?;
        policy.network().spec().check_compatible(replay.spec())?;
        if self.settings.average_rate.is_none() {
            return self.take_steps(policy, &mut [], replay, rng);
        }
        let mut params = std::mem::take(&mut self.trained_params);
        policy.params_mut().swap_with_slice(&mut params);
        let stats = self.take_steps(policy, &mut params, replay, rng);
        policy.params_mut().swap_with_slice(&mut params);
        self.trained_params = params;
        let stats = stats?;
        check_all_finite("an averaged parameter after the update", policy.params())?;
        Ok(stats)
    }

    /// Returns both moments of Adam, its number of steps, the target critics, the trained
    /// parameters if the policy averages them, and a learned temperature.
    fn save(&self) -> AlgorithmState<'_> {
        let alpha = &self.alpha_optimiser;
        let mut state = self.optimiser.save();
        state.tensors.push((TARGET_PARAMS, &self.target_params));
        if self.settings.average_rate.is_some() {
            state.tensors.push((TRAINED_PARAMS, &self.trained_params));
        }
        // a fixed temperature has no state, so a state with a learned one does not fit it
        if matches!(self.settings.temperature, EntropyTemperatureSettings::Learned { .. }) {
            state.tensors.extend([
                (TEMPERATURE, &self.log_alpha[..]),
                (TEMPERATURE_FIRST, &alpha.first_moment),
                (TEMPERATURE_SECOND, &alpha.second_moment),
            ]);
        }
        state
    }

    fn restore(&mut self, state: &AlgorithmState<'_>) -> Result<(), RlError> {
        state.check_same_layout(&self.save())?;
        check_not_negative(state, &[SECOND_MOMENT_NAME, TEMPERATURE_SECOND])?;
        let alpha = &mut self.alpha_optimiser;
        for (name, saved) in &state.tensors {
            let own: &mut [f32] = match *name {
                TARGET_PARAMS => &mut self.target_params,
                TRAINED_PARAMS => &mut self.trained_params,
                TEMPERATURE => &mut self.log_alpha,
                TEMPERATURE_FIRST => &mut alpha.first_moment,
                TEMPERATURE_SECOND => &mut alpha.second_moment,
                // the optimiser's, which it restores itself
                _ => continue,
            };
            own.copy_from_slice(saved);
        }
        self.optimiser.restore(state);
        // both optimisers step together
        alpha.steps = self.optimiser.steps;
        Ok(())
    }
}

impl fmt::Debug for Sac {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Sac")
            .field("settings", &self.settings)
            .field("steps", &self.optimiser.steps)
            .finish_non_exhaustive()
    }
}
