//! The rollout buffer: T steps of N environments, time-major.

use std::fmt;

use rand_chacha::ChaCha8Rng;

use crate::distributions::ActionNoise;
use crate::env::{EnvSpec, Observations, StepOutcome, Transition};
use crate::error::{
    RlError, check_all_finite, check_finite, check_len, require_count, require_share,
};
use crate::gae::{GaeInputs, gae};
use crate::policy::{Decisions, EvaluateActions, OnPolicyActor, ValueFunction};
use crate::rollout::ExperienceBuffer;

/// Rollout buffer of T steps of N environments, allocated once.
/// [`collect_experience`](crate::collect_experience) fills it; by hand, `push` T times, `finish`,
/// read, `clear`.
#[derive(Clone)]
pub struct RolloutBuffer {
    spec: EnvSpec,
    /// Number of steps of every environment that fit into the buffer.
    capacity: usize,
    /// Number T of steps in a full rollout: the capacity, or less after
    /// [`RolloutBuffer::truncate`].
    steps: usize,
    pushed: usize,
    finished: bool,
    observations: Observations,
    decisions: Decisions,
    rewards: Vec<f32>,
    outcomes: Vec<StepOutcome>,
    final_values: Vec<f32>,
    last_values: Vec<f32>,
    /// Final observations of the episodes that were truncated by a time limit, in the order of
    /// `truncated_samples`.
    final_observations: Observations,
    /// Indices t * N + n, ascending, of the steps in which a time limit truncated the episode of
    /// environment n.
    truncated_samples: Vec<usize>,
    last_observations: Observations,
    /// Exploration noise of the actions.
    noise: ActionNoise,
    /// Decisions of the step that is being collected, `[N]`.
    step_decisions: Decisions,
    /// State values of the final observations of the step that is being collected, `[N]`.
    step_final_values: Vec<f32>,
}

impl RolloutBuffer {
    /// Allocates a buffer for `steps` (T, at least 1) steps of the environments of `spec`.
    ///
    /// # Errors
    /// [`RlError::EmptySpec`] or [`RlError::InvalidSetting`] when a size is zero,
    /// [`RlError::NotEnoughMemory`] if the machine has too little memory.
    pub fn new(spec: &EnvSpec, steps: usize) -> Result<Self, RlError> {
        spec.check_rollout_memory(steps)?;
        let all = EnvSpec { num_envs: spec.num_envs * steps, ..spec.clone() };
        Ok(Self {
            spec: spec.clone(),
            capacity: steps,
            steps,
            pushed: 0,
            finished: false,
            observations: Observations::new(&all),
            decisions: Decisions::new(&all),
            rewards: vec![0.0; all.num_envs],
            outcomes: vec![StepOutcome::Running; all.num_envs],
            final_values: vec![0.0; all.num_envs],
            last_values: vec![0.0; spec.num_envs],
            final_observations: Observations::empty(),
            truncated_samples: Vec::new(),
            last_observations: Observations::new(spec),
            noise: ActionNoise::independent(spec.num_envs, spec.action_irreps.len()),
            step_decisions: Decisions::new(spec),
            step_final_values: vec![0.0; spec.num_envs],
        })
    }

    /// Sets the correlation c of the exploration noise of consecutive steps that
    /// [`collect_experience`](crate::collect_experience) draws: x_t = c x_(t-1) + sqrt(1 - c^2) e_t
    /// with standard normal e, so that x is standard normal, too. The noise restarts with every
    /// episode and every collection, so [`RolloutState`](crate::RolloutState) stays the complete
    /// state between two collections. A new buffer has c = 0: independent noise.
    ///
    /// Log-probabilities are marginal ones of each decision, as in Hollenstein et al., "Colored
    /// noise in PPO" (AAAI 2024), whose noise has another spectrum. With c above 0 they differ from
    /// those conditional on the previous decisions, so the gradient of an update is biased.
    ///
    /// # Errors
    /// [`RlError::InvalidSetting`] for a correlation outside [0, 1).
    pub fn with_noise_correlation(mut self, correlation: f32) -> Result<Self, RlError> {
        self.noise.set_correlation(correlation)?;
        Ok(self)
    }

    /// Appends one step of all environments: the observations before it, the policy's decisions,
    /// the transition, and the state values of the final observations `[N]` (read only for
    /// truncated outcomes).
    ///
    /// # Errors
    /// [`RlError::BufferFull`] past T steps, [`RlError::ShapeMismatch`] when an array does not fit,
    /// [`RlError::NotFinite`] for a reward, decision, value or vector that is infinite or NaN.
    pub fn push(
        &mut self,
        observations: &Observations,
        decisions: &Decisions,
        transition: &Transition,
        final_values: &[f32],
    ) -> Result<(), RlError> {
        if self.pushed == self.steps {
            return Err(RlError::BufferFull { steps: self.steps });
        }
        let n = self.spec.num_envs;
        observations.check_lengths(&self.spec, n)?;
        observations.check_finite(&self.spec)?;
        decisions.check_lengths(&self.spec, n)?;
        decisions.check_finite()?;
        transition.check(&self.spec)?;
        check_final_values(&transition.outcomes, final_values)?;
        let t = self.pushed;
        copy_row(&mut self.observations.images, t, &observations.images);
        copy_row(&mut self.observations.vectors, t, &observations.vectors);
        copy_row(&mut self.decisions.actions, t, &decisions.actions);
        copy_row(&mut self.decisions.log_probs, t, &decisions.log_probs);
        copy_row(&mut self.decisions.values, t, &decisions.values);
        copy_row(&mut self.rewards, t, &transition.rewards);
        copy_row(&mut self.outcomes, t, &transition.outcomes);
        copy_row(&mut self.final_values, t, final_values);
        // before `pushed` counts the step, whose index it needs
        self.store_final_observations(transition);
        self.pushed += 1;
        Ok(())
    }

    /// Stores the final observations of episodes that were truncated in the step that is being
    /// pushed, which [`RolloutBuffer::reevaluate`] needs.
    fn store_final_observations(&mut self, transition: &Transition) {
        for (n, &outcome) in transition.outcomes.iter().enumerate() {
            if outcome == StepOutcome::Truncated {
                let (image, vector) = transition.final_observations.image_and_vector(&self.spec, n);
                self.final_observations.images.extend_from_slice(image);
                self.final_observations.vectors.extend_from_slice(vector);
                self.truncated_samples.push(self.pushed * self.spec.num_envs + n);
            }
        }
    }

    /// Completes a full buffer with the observations after its last step and their state values
    /// `[N]`.
    ///
    /// # Errors
    /// [`RlError::BufferNotFinished`] before T steps were pushed, [`RlError::ShapeMismatch`] for a
    /// wrong length, [`RlError::NotFinite`] for values or vectors that are infinite or NaN.
    pub fn finish(&mut self, last: &Observations, last_values: &[f32]) -> Result<(), RlError> {
        if self.pushed != self.steps {
            return Err(RlError::BufferNotFinished { got: self.pushed, steps: self.steps });
        }
        check_len("last_values", "[N]", last_values.len(), self.spec.num_envs)?;
        check_all_finite("a value", last_values)?;
        last.check_lengths(&self.spec, self.spec.num_envs)?;
        last.check_finite(&self.spec)?;
        self.last_values.copy_from_slice(last_values);
        self.last_observations.clone_from(last);
        self.finished = true;
        Ok(())
    }

    /// Recomputes the rollout's log-probabilities and state values, bootstrapped ones included,
    /// under `policy`, so that `policy` can be trained on actions of another policy: probability
    /// ratios start at 1, and advantages refer to its own values. The shift of the state
    /// distribution is not corrected. After an error, nothing has changed.
    ///
    /// # Errors
    /// [`RlError::BufferNotFinished`] before `finish`, [`RlError::ShapeMismatch`] for a policy of
    /// other environments, [`RlError::NotFinite`] for log-probabilities or values that are infinite
    /// or NaN.
    pub fn reevaluate<P: EvaluateActions>(&mut self, policy: &mut P) -> Result<(), RlError> {
        self.check_finished()?;
        let mut decisions = self.decisions.clone();
        policy.evaluate_actions(&self.observations, &mut decisions)?;
        decisions.check_lengths(&self.spec, self.num_samples())?;
        decisions.check_finite()?;
        let final_values =
            finite_values(policy, &self.final_observations, self.truncated_samples.len())?;
        let last_values = finite_values(policy, &self.last_observations, self.spec.num_envs)?;
        // after the last possible error
        self.decisions.log_probs = decisions.log_probs;
        self.decisions.values = decisions.values;
        self.last_values = last_values;
        for (&sample, value) in self.truncated_samples.iter().zip(final_values) {
            self.final_values[sample] = value;
        }
        Ok(())
    }

    /// Removes every step of the rollout and keeps the buffer's allocations.
    pub fn clear(&mut self) {
        self.pushed = 0;
        self.finished = false;
        self.truncated_samples.clear();
        self.final_observations.images.clear();
        self.final_observations.vectors.clear();
        // a truncated buffer gets its capacity back
        self.resize(self.capacity);
    }

    /// Writes the advantages and the returns of all decisions, each `[T, N]`, which [`gae`]
    /// computes with the discount `gamma` and the decay `lambda`, both in [0, 1].
    ///
    /// # Errors
    /// [`RlError::BufferNotFinished`] before `finish`, [`RlError::ShapeMismatch`] for wrong
    /// lengths, [`RlError::InvalidSetting`] for a `gamma` or `lambda` out of range.
    pub fn write_advantages_and_returns(
        &self,
        gamma: f32,
        lambda: f32,
        advantages: &mut [f32],
        returns: &mut [f32],
    ) -> Result<(), RlError> {
        self.check_finished()?;
        require_share("gamma", gamma)?;
        require_share("lambda", lambda)?;
        check_len("advantages", "[T, N]", advantages.len(), self.num_samples())?;
        check_len("returns", "[T, N]", returns.len(), self.num_samples())?;
        let inputs = GaeInputs {
            rewards: &self.rewards,
            values: &self.decisions.values,
            outcomes: &self.outcomes,
            final_values: &self.final_values,
            last_values: &self.last_values,
        };
        gae(&inputs, gamma, lambda, advantages, returns);
        Ok(())
    }

    /// Rejects a rollout buffer shorter than an episode of `horizon` steps
    /// ([`VectorEnv::horizon`](crate::VectorEnv::horizon)). For rollouts that begin with a reset:
    /// they would never reach an episode's late states.
    ///
    /// # Errors
    /// [`RlError::ShortRollout`] if T is below `horizon`.
    pub fn check_horizon(&self, horizon: usize) -> Result<(), RlError> {
        if self.steps >= horizon {
            return Ok(());
        }
        Err(RlError::ShortRollout { steps: self.steps, horizon })
    }

    /// Rejects a rollout buffer that is not full or not completed by [`RolloutBuffer::finish`].
    pub(crate) fn check_finished(&self) -> Result<(), RlError> {
        if self.finished {
            Ok(())
        } else {
            Err(RlError::BufferNotFinished { got: self.pushed, steps: self.steps })
        }
    }

    /// Returns the sizes and symmetry types of the environments that the buffer stores steps of.
    pub fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    /// Returns T, the number of steps of every environment in a full rollout: those allocated, or
    /// fewer after [`RolloutBuffer::truncate`].
    pub fn steps_per_env(&self) -> usize {
        self.steps
    }

    /// Returns T * N, the number of decisions of a full rollout.
    pub fn num_samples(&self) -> usize {
        self.steps * self.spec.num_envs
    }

    /// Returns the observations that the policy acted on, `[T, N, ...]`: sample t * N + n is
    /// environment n at step t.
    pub fn observations(&self) -> &Observations {
        &self.observations
    }

    /// Returns the rollout's actions `[T, N, A]`, with log-probabilities and values `[T, N]` from
    /// the collection or from [`RolloutBuffer::reevaluate`].
    pub fn decisions(&self) -> &Decisions {
        &self.decisions
    }

    /// Returns the reward of every step of the rollout, `[T, N]`.
    pub fn rewards(&self) -> &[f32] {
        &self.rewards
    }

    /// Returns the state of the episode after every step of the rollout, `[T, N]`.
    pub fn outcomes(&self) -> &[StepOutcome] {
        &self.outcomes
    }
}

impl fmt::Debug for RolloutBuffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RolloutBuffer")
            .field("spec", &self.spec)
            .field("steps", &self.steps)
            .field("pushed", &self.pushed)
            .field("finished", &self.finished)
            .finish_non_exhaustive()
    }
}

/// Returns the state values of `samples` observations under `policy`, and rejects infinities and
/// NaN.
fn finite_values<P: ValueFunction>(
    policy: &mut P,
    observations: &Observations,
    samples: usize,
) -> Result<Vec<f32>, RlError> {
    let mut values = vec![0.0; samples];
    policy.values(observations, &mut values)?;
    check_all_finite("a value", &values)?;
    Ok(values)
}

/// Checks the state values `[N]` of final observations; those of truncated episodes, from which
/// returns bootstrap, must be finite.
fn check_final_values(outcomes: &[StepOutcome], values: &[f32]) -> Result<(), RlError> {
    check_len("final_values", "[N]", values.len(), outcomes.len())?;
    let bootstrapped = outcomes.iter().zip(values);
    bootstrapped
        .filter(|(outcome, _)| **outcome == StepOutcome::Truncated)
        .try_for_each(|(_, &value)| check_finite("the value of a final observation", value.into()))
}

/// Copies `row`, the values of one step, to step `t` of `array`, which holds such a row for each
/// step.
fn copy_row<T: Copy>(array: &mut [T], t: usize, row: &[T]) {
    array[t * row.len()..(t + 1) * row.len()].copy_from_slice(row);
}

impl<P: OnPolicyActor> ExperienceBuffer<P> for RolloutBuffer {
    /// Returns the number of steps for which the buffer was allocated, also after
    /// [`RolloutBuffer::truncate`].
    #[allow(clippy::misnamed_getters, reason = "`steps` are those of the last rollout")]
    fn steps_per_env(&self) -> usize {
        self.capacity
    }

    fn begin(&mut self, spec: &EnvSpec) -> Result<(), RlError> {
        self.spec.check_compatible(spec)?;
        check_len("environments", "[N]", spec.num_envs, self.spec.num_envs)?;
        self.clear();
        self.noise.restart_all();
        Ok(())
    }

    fn action_buffer(&mut self) -> (&mut [f32], bool) {
        (&mut self.step_decisions.actions, false)
    }

    /// Samples actions from `policy` with the exploration noise, and stores them with
    /// log-probabilities and state values.
    fn decide(
        &mut self,
        policy: &mut P,
        observations: &Observations,
        memory: &mut P::Memory,
        rng: &mut ChaCha8Rng,
    ) -> Result<&[f32], RlError> {
        let noise = self.noise.sample(rng);
        policy.decide(observations, memory, noise, &mut self.step_decisions)?;
        Ok(&self.step_decisions.actions)
    }

    fn record(
        &mut self,
        policy: &mut P,
        from: &Observations,
        to: &Transition,
    ) -> Result<(), RlError> {
        value_truncated(policy, to, &mut self.step_final_values)?;
        // taken out for the call, since `push` borrows the whole buffer mutably
        let decisions = std::mem::take(&mut self.step_decisions);
        let final_values = std::mem::take(&mut self.step_final_values);
        let result = self.push(from, &decisions, to, &final_values);
        (self.step_decisions, self.step_final_values) = (decisions, final_values);
        result?;
        self.noise.restart_ended(&to.outcomes);
        Ok(())
    }

    fn end(&mut self, policy: &mut P, last: &Observations) -> Result<(), RlError> {
        let mut values = vec![0.0; self.spec.num_envs];
        policy.values(last, &mut values)?;
        self.finish(last, &values)
    }
}

/// Computes the state values of the final observations if a time limit truncated any episode, which
/// then bootstraps from one.
fn value_truncated<P: ValueFunction>(
    policy: &mut P,
    transition: &Transition,
    out: &mut [f32],
) -> Result<(), RlError> {
    if transition.outcomes.contains(&StepOutcome::Truncated) {
        policy.values(&transition.final_observations, out)?;
    }
    Ok(())
}

impl RolloutBuffer {
    /// Shortens a finished rollout to its first `steps` steps, until [`RolloutBuffer::clear`]; a
    /// shorter rollout stays as it is. Episodes that still run at the cut bootstrap from the
    /// recorded values of the next step.
    ///
    /// # Errors
    /// [`RlError::BufferNotFinished`] before `finish`, [`RlError::InvalidSetting`] for 0 steps.
    pub fn truncate(&mut self, steps: usize) -> Result<(), RlError> {
        self.check_finished()?;
        require_count("steps", steps, 1, "at least 1")?;
        if steps >= self.steps {
            return Ok(());
        }
        let n = self.spec.num_envs;
        // the first dropped step becomes the one after the last
        let (from, to) = (steps * n, (steps + 1) * n);
        let (image, vector) = (self.spec.image_len(), self.spec.vector_irreps.len());
        let next = &self.observations;
        self.last_observations.images.copy_from_slice(&next.images[from * image..to * image]);
        self.last_observations.vectors.copy_from_slice(&next.vectors[from * vector..to * vector]);
        self.last_values.copy_from_slice(&self.decisions.values[from..to]);
        let ends = self.truncated_samples.partition_point(|&sample| sample < from);
        self.truncated_samples.truncate(ends);
        self.final_observations.images.truncate(ends * image);
        self.final_observations.vectors.truncate(ends * vector);
        self.resize(steps);
        self.pushed = steps;
        Ok(())
    }

    /// Resizes all arrays of the buffer to `steps` steps of every environment and keeps the first
    /// steps.
    pub(super) fn resize(&mut self, steps: usize) {
        let (spec, samples) = (&self.spec, steps * self.spec.num_envs);
        self.observations.images.resize(samples * spec.image_len(), 0);
        self.observations.vectors.resize(samples * spec.vector_irreps.len(), 0.0);
        self.decisions.actions.resize(samples * spec.action_irreps.len(), 0.0);
        self.decisions.log_probs.resize(samples, 0.0);
        self.decisions.values.resize(samples, 0.0);
        self.rewards.resize(samples, 0.0);
        self.outcomes.resize(samples, StepOutcome::Running);
        self.final_values.resize(samples, 0.0);
        self.steps = steps;
    }
}
