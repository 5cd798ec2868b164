//! Collection of experience with sampled actions, and evaluation with mean actions.

use std::fmt;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::env::{EnvSpec, Observations, Transition, VectorEnv};
use crate::error::{RlError, check_len, check_rows_finite, require};
use crate::policy::{Actor, ActorMemory};

/// State of the collection of experience from N environments between two rollouts: observations,
/// running episodes and the actor's memory.
#[derive(Clone, Debug, PartialEq)]
pub struct RolloutState<M = ()> {
    /// Observations that the actor acts on next.
    pub observations: Observations,
    /// Statistics of each environment's running episode so far, `[N]`.
    pub episodes: Vec<EpisodeStats>,
    /// Recurrent memory that the actor has of the running episodes.
    pub memory: M,
}

/// Statistics of one episode, running or ended.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EpisodeStats {
    /// Index of the environment that runs the episode, in 0..N.
    pub env: usize,
    /// Number of steps taken in the episode.
    pub length: usize,
    /// Undiscounted sum of the episode's rewards so far.
    pub total_reward: f64,
    /// `true` if the task's success condition held at any time of the episode.
    pub success: bool,
    /// `true` if the task's success condition held at the end of the episode's last step.
    pub success_at_end: bool,
}

/// Statistics of a rollout: its decisions and the episodes that ended during it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RolloutStats {
    /// Number of decisions taken in the rollout, T * N for T steps of N environments.
    pub decisions: usize,
    /// Episodes that ended during the rollout, in the order in which they ended.
    pub episodes: Vec<EpisodeStats>,
    /// Largest magnitude of the undiscounted return of any episode up to any step, running
    /// episodes included.
    pub max_abs_return: f64,
}

impl RolloutStats {
    /// Returns the mean undiscounted return of the episodes that ended; `None` if none did.
    pub fn mean_return(&self) -> Option<f64> {
        self.mean(|e| e.total_reward)
    }

    /// Returns the share in [0, 1] of the rollout's ended episodes with success at any time; `None`
    /// if none ended.
    pub fn success_rate(&self) -> Option<f64> {
        self.mean(|e| f64::from(u8::from(e.success)))
    }

    /// Returns the share in [0, 1] of the rollout's ended episodes with success at the end of their
    /// last step; `None` if no episode ended.
    pub fn success_at_end_rate(&self) -> Option<f64> {
        self.mean(|e| f64::from(u8::from(e.success_at_end)))
    }

    /// Returns a warning if the largest magnitude of an episode's return is above
    /// [`MAX_RECOMMENDED_ABS_RETURN`], or below [`MIN_RECOMMENDED_ABS_RETURN`] but not zero;
    /// otherwise `None`.
    pub fn reward_warning(&self) -> Option<RewardWarning> {
        RewardWarning::for_max_abs_return(self.max_abs_return)
    }

    /// Counts one step of all environments, after which the episodes `ended` are over and the
    /// episodes `running` go on.
    pub(crate) fn count_step(&mut self, ended: &[EpisodeStats], running: &[EpisodeStats]) {
        self.decisions += running.len();
        let returns = ended.iter().chain(running).map(|e| e.total_reward.abs());
        self.max_abs_return = returns.fold(self.max_abs_return, f64::max);
    }

    fn mean(&self, of: impl Fn(&EpisodeStats) -> f64) -> Option<f64> {
        let count = self.episodes.len();
        (count > 0).then(|| self.episodes.iter().map(of).sum::<f64>() / count as f64)
    }
}

impl<M: ActorMemory> RolloutState<M> {
    /// Resets the environments and returns the state at the beginning of their episodes, with an
    /// empty memory for `actor`.
    ///
    /// # Errors
    /// [`RlError::Environment`] when the reset fails, [`RlError::ShapeMismatch`] when it changes
    /// the sizes of its output, [`RlError::NotFinite`] for vectors that are not numbers.
    pub fn from_env_reset<A: Actor<Memory = M>>(
        env: &mut dyn VectorEnv,
        actor: &A,
    ) -> Result<Self, RlError> {
        let spec = env.spec().clone();
        spec.check()?;
        let mut observations = Observations::new(&spec);
        env.reset(&mut observations).map_err(RlError::Environment)?;
        observations.check_lengths(&spec, spec.num_envs)?;
        observations.check_finite(&spec).map_err(|error| error.with_step(|_| Some(0)))?;
        Ok(Self {
            observations,
            episodes: (0..spec.num_envs).map(new_episode).collect(),
            memory: actor.new_memory(spec.num_envs),
        })
    }

    /// Records the executed actions `[N, A]` and their rewards in the actor's memory.
    pub(crate) fn remember_step(&mut self, actions: &[f32], rewards: &[f32]) {
        let width = actions.len() / rewards.len().max(1);
        for (n, (action, &reward)) in actions.chunks(width.max(1)).zip(rewards).enumerate() {
            self.memory.remember_step(n, action, reward);
        }
    }

    /// Adds one step to the statistics of the running episodes and takes over its next
    /// observations; returns the statistics of the episodes that ended, which the actor's memory
    /// then forgets.
    pub(crate) fn advance(&mut self, transition: &mut Transition) -> Vec<EpisodeStats> {
        // the environment overwrites the old observations in its next step
        std::mem::swap(&mut self.observations, &mut transition.observations);
        let mut ended = Vec::new();
        for (n, episode) in self.episodes.iter_mut().enumerate() {
            episode.length += 1;
            episode.total_reward += f64::from(transition.rewards[n]);
            episode.success |= transition.success[n];
            episode.success_at_end = transition.success_at_end[n];
            if transition.outcomes[n].is_ended() {
                ended.push(std::mem::replace(episode, new_episode(n)));
                self.memory.forget_episode(n);
            }
        }
        ended
    }
}

/// Checks `actions` `[N, A]`, steps the environments with them and checks the transition. The
/// running `episodes` give the step for error messages.
pub(crate) fn step(
    env: &mut dyn VectorEnv,
    episodes: &[EpisodeStats],
    actions: &[f32],
    transition: &mut Transition,
) -> Result<(), RlError> {
    let spec = env.spec();
    let taken = |index: usize| episodes.get(index).map(|episode| episode.length);
    let expected = spec.num_envs * spec.action_irreps.len();
    check_len("actions", "[N, A]", actions.len(), expected)?;
    // before the step: a NaN can break the state of a simulation for good
    check_rows_finite("an action", actions, spec.action_irreps.len())
        .map_err(|error| error.with_step(taken))?;
    env.step(actions, transition).map_err(RlError::Environment)?;
    transition.check(env.spec()).map_err(|error| error.with_step(|index| Some(taken(index)? + 1)))
}

fn new_episode(env: usize) -> EpisodeStats {
    EpisodeStats { env, ..EpisodeStats::default() }
}

/// Runs `actor` in the environments from `state` on, for [`ExperienceBuffer::steps_per_env`] steps,
/// and records the steps in `experience`. Environments restart by themselves.
///
/// Pass the same `state` again and episodes continue across collections. If every collection begins
/// with a reset instead, it must last as long as an episode: a shorter one never reaches late
/// states, and no episode ends, so returns are `None`. `collect_experience` cannot know about
/// resets; check with [`RolloutBuffer::check_horizon`](crate::RolloutBuffer::check_horizon).
///
/// # Errors
/// [`RlError::Environment`] when a step fails, [`RlError::ShapeMismatch`] or
/// [`RlError::SpecMismatch`] when environment, actor, state and experience do not fit together,
/// [`RlError::NotFinite`] for rewards, observations, actions or decisions that are infinite or NaN,
/// [`RlError::InvalidSetting`] if [`ExperienceBuffer::steps_per_env`] is 0.
///
/// After an error, environments, `state` and `experience` may be at different steps. Start again
/// with [`RolloutState::from_env_reset`].
pub fn collect_experience<A: Actor, E: ExperienceBuffer<A>>(
    env: &mut dyn VectorEnv,
    actor: &mut A,
    experience: &mut E,
    state: &mut RolloutState<A::Memory>,
    rng: &mut ChaCha8Rng,
) -> Result<RolloutStats, RlError> {
    let spec = env.spec().clone();
    let steps = experience.steps_per_env();
    require("steps", steps as f32, "at least 1 step", steps > 0)?;
    check_len("episodes", "[N]", state.episodes.len(), spec.num_envs)?;
    state.observations.check_lengths(&spec, spec.num_envs)?;
    let mut transition = Transition::new(&spec);
    let mut stats = RolloutStats::default();
    experience.begin(&spec)?;
    for _ in 0..steps {
        let (memory, observations) = (&mut state.memory, &state.observations);
        let actions = experience.decide(actor, observations, memory, rng)?;
        step(env, &state.episodes, actions, &mut transition)?;
        // before `advance`, which lets the memory forget episodes that ended
        state.remember_step(actions, &transition.rewards);
        experience.record(actor, &state.observations, &transition)?;
        let ended = state.advance(&mut transition);
        stats.count_step(&ended, &state.episodes);
        stats.episodes.extend(ended);
    }
    experience.end(actor, &state.observations)?;
    Ok(stats)
}

/// Storage that [`collect_experience`] fills: a rollout buffer for one update, or a growing replay
/// buffer.
///
/// [`collect_experience`] calls `begin`; then, [`ExperienceBuffer::steps_per_env`] times, `decide`,
/// one step of the environments and `record`; then `end`.
pub trait ExperienceBuffer<A: Actor> {
    /// Returns the number of steps of every environment in one collection, at least 1.
    fn steps_per_env(&self) -> usize;

    /// Prepares the storage for steps of the environments of `spec`. A rollout buffer is cleared, a
    /// replay buffer keeps its steps.
    ///
    /// # Errors
    /// [`RlError::SpecMismatch`] for other environments than the storage was made for.
    fn begin(&mut self, spec: &EnvSpec) -> Result<(), RlError>;

    /// Returns the buffer for the actions `[N, A]` of the next step, and `true` if that step is in
    /// the warm-up, in which actions are drawn uniformly from [-1, 1].
    fn action_buffer(&mut self) -> (&mut [f32], bool);

    /// Lets `actor` choose actions, stores the decision as far as the algorithm needs it, and
    /// returns the actions `[N, A]`. The default stores the actions only.
    ///
    /// # Errors
    /// Errors of the actor.
    fn decide(
        &mut self,
        actor: &mut A,
        observations: &Observations,
        memory: &mut A::Memory,
        rng: &mut ChaCha8Rng,
    ) -> Result<&[f32], RlError> {
        let (actions, warm_up) = self.action_buffer();
        // in a warm-up, too: a recurrent actor's memory needs every observation
        actor.act(observations, memory, rng, actions)?;
        if warm_up {
            actions.fill_with(|| rng.random_range(-1.0..=1.0));
        }
        Ok(actions)
    }

    /// Stores the step that the last actions led to: the observations `from` before it and the
    /// transition `to`.
    ///
    /// # Errors
    /// Errors of the actor, or an array that does not fit.
    fn record(
        &mut self,
        actor: &mut A,
        from: &Observations,
        to: &Transition,
    ) -> Result<(), RlError>;

    /// Ends the collection; `last` are the observations that the actor would have acted on next.
    ///
    /// # Errors
    /// Errors of the actor, or an array that does not fit.
    fn end(&mut self, _actor: &mut A, _last: &Observations) -> Result<(), RlError> {
        Ok(())
    }
}

/// Resets the environments, runs `rounds` episodes in each with the actor's mean actions, and
/// returns the statistics of these episodes.
///
/// Episodes must end, by termination or a time limit; otherwise the evaluation never returns.
/// Counting the same number of episodes in every environment keeps short episodes from being
/// over-represented.
///
/// # Errors
/// [`RlError::Environment`] when a step fails, [`RlError::ShapeMismatch`] when environment and
/// actor differ in size, [`RlError::NotFinite`] for rewards, observations or actions that are not
/// numbers.
pub fn evaluate_policy<A: Actor>(
    env: &mut dyn VectorEnv,
    actor: &mut A,
    rounds: usize,
) -> Result<RolloutStats, RlError> {
    evaluate_policy_with_callback(env, actor, rounds, |_, _| Ok(()))
}

/// Evaluates like [`evaluate_policy`] and calls `callback` with the actor and the state of the
/// environments before every decision.
///
/// # Errors
/// Errors of [`evaluate_policy`], and of `callback`.
pub fn evaluate_policy_with_callback<A: Actor>(
    env: &mut dyn VectorEnv,
    actor: &mut A,
    rounds: usize,
    mut callback: impl FnMut(&A, &RolloutState<A::Memory>) -> Result<(), RlError>,
) -> Result<RolloutStats, RlError> {
    let spec = env.spec().clone();
    let mut state = RolloutState::from_env_reset(env, actor)?;
    let mut transition = Transition::new(&spec);
    let mut actions = vec![0.0; spec.num_envs * spec.action_irreps.len()];
    let mut left = vec![rounds; spec.num_envs];
    let mut stats = RolloutStats::default();
    while left.iter().any(|&open| open > 0) {
        callback(actor, &state)?;
        actor.mean_actions(&state.observations, &mut state.memory, &mut actions)?;
        step(env, &state.episodes, &actions, &mut transition)?;
        state.remember_step(&actions, &transition.rewards);
        let ended = state.advance(&mut transition);
        stats.count_step(&ended, &state.episodes);
        // an environment that has run its episodes still steps with the others, but does not count
        for episode in ended {
            if left[episode.env] > 0 {
                left[episode.env] -= 1;
                stats.episodes.push(episode);
            }
        }
    }
    Ok(stats)
}

/// Largest magnitude of an episode's undiscounted return without a [`RewardWarning`]. Beyond it,
/// the gradient of the value function crowds out the policy's, since both are clipped to one common
/// norm.
pub const MAX_RECOMMENDED_ABS_RETURN: f64 = 1e3;

/// Smallest non-zero magnitude of an episode's undiscounted return without a [`RewardWarning`].
/// Below it, the initial errors of the value function exceed the differences between rewards.
pub const MIN_RECOMMENDED_ABS_RETURN: f64 = 1e-2;

/// Warning about returns outside the range in which PPO with default settings was measured to
/// train without a [`NormalisedEnv`](crate::NormalisedEnv).
///
/// Measured in a task of one step (`tests/reward_scale.rs`), where rewards reach `scale`, after 30
/// rollouts of 512 decisions, as the success of mean actions and of drawn ones:
///
/// | scale | 1e-4 | 1e-3 | 1e-2 | 0.1 | 1 | 10 | 1e2 | 1e3 | 1e4 | 1e5 | 1e6 | 1e7 |
/// |---|---|---|---|---|---|---|---|---|---|---|---|---|
/// | mean | 0.06 | 0.25 | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 | 0.10 |
/// | drawn | 0.11 | 0.16 | 0.45 | 0.89 | 0.90 | 0.84 | 0.37 | 0.36 | 0.34 | 0.24 | 0.16 | 0.13 |
///
/// So training is best for returns of order 1, and slow at the bounds. While all rewards are zero,
/// there is no warning. Returns are undiscounted, so episodes of thousands of steps may exceed the
/// bound although their discounted values do not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RewardWarning {
    /// Undiscounted returns of episodes with magnitudes above [`MAX_RECOMMENDED_ABS_RETURN`].
    TooLarge {
        /// Largest magnitude of an episode's return so far.
        largest: f64,
    },
    /// Undiscounted returns of episodes with magnitudes below [`MIN_RECOMMENDED_ABS_RETURN`],
    /// though not zero.
    TooSmall {
        /// Largest magnitude of an episode's return so far.
        largest: f64,
    },
}

impl RewardWarning {
    /// Returns the warning for the largest magnitude of an episode's return; `None` if it is in
    /// range.
    pub fn for_max_abs_return(largest: f64) -> Option<Self> {
        if largest > MAX_RECOMMENDED_ABS_RETURN {
            Some(Self::TooLarge { largest })
        } else if largest > 0.0 && largest < MIN_RECOMMENDED_ABS_RETURN {
            Some(Self::TooSmall { largest })
        } else {
            None
        }
    }
}

impl fmt::Display for RewardWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (largest, effect) = match self {
            Self::TooLarge { largest } => (largest, "exploration may not shrink"),
            Self::TooSmall { largest } => (largest, "training may make little or no progress"),
        };
        write!(
            f,
            "returns of episodes reach {largest:.1e} in magnitude, expected between \
             {MIN_RECOMMENDED_ABS_RETURN:e} and {MAX_RECOMMENDED_ABS_RETURN:e}: {effect}; divide rewards by their usual \
             size in the environment"
        )
    }
}
