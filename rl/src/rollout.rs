//! Collection of experience with sampled actions, and evaluation with mean ones.

use std::fmt;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::env::{EnvSpec, Observations, Transition, VectorEnv};
use crate::error::{RlError, check_len, check_rows_finite, require};
use crate::policy::{Actor, Memory};

/// State of N environments between two rollouts. The fields are all of it.
#[derive(Clone, Debug, PartialEq)]
pub struct RolloutState<M = ()> {
    /// Observations that the actor acts on next.
    pub observations: Observations,
    /// The running episodes so far, `[N]`.
    pub episodes: Vec<Episode>,
    /// The actor's memory of them.
    pub memory: M,
}

/// One episode: so far, or as it ended.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Episode {
    /// Index of the environment, in 0..N.
    pub env: usize,
    /// Number of steps.
    pub length: usize,
    /// Undiscounted sum of rewards.
    pub total_reward: f64,
    /// `true` if the success condition held at any time of the episode.
    pub success: bool,
    /// `true` if the success condition held at the end of the last step.
    pub success_at_end: bool,
}

/// The episodes that ended during a rollout.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RolloutStats {
    /// T * N, the number of decisions taken.
    pub decisions: usize,
    /// Episodes in the order in which they ended.
    pub episodes: Vec<Episode>,
    /// Largest magnitude of the undiscounted return of an episode up to any of its steps, of
    /// episodes that have not ended, too.
    pub largest_return: f64,
}

impl RolloutStats {
    /// Mean undiscounted return; `None` when no episode ended.
    pub fn mean_return(&self) -> Option<f64> {
        self.mean(|e| e.total_reward)
    }

    /// Share in [0, 1] of episodes with success at any time; `None` when no episode ended.
    pub fn success_rate(&self) -> Option<f64> {
        self.mean(|e| f64::from(u8::from(e.success)))
    }

    /// Share in [0, 1] of episodes with success at the end of their last step;
    /// `None` when no episode ended.
    pub fn success_at_end_rate(&self) -> Option<f64> {
        self.mean(|e| f64::from(u8::from(e.success_at_end)))
    }

    /// Returns a warning where rewards are too large or too small to be learnt from.
    pub fn reward_warning(&self) -> Option<RewardWarning> {
        RewardWarning::of(self.largest_return)
    }

    /// Books one step of all environments, after which these episodes have ended or go on.
    pub(crate) fn count_step(&mut self, ended: &[Episode], running: &[Episode]) {
        self.decisions += running.len();
        let returns = ended.iter().chain(running).map(|e| e.total_reward.abs());
        self.largest_return = returns.fold(self.largest_return, f64::max);
    }

    fn mean(&self, of: impl Fn(&Episode) -> f64) -> Option<f64> {
        let count = self.episodes.len();
        (count > 0).then(|| self.episodes.iter().map(of).sum::<f64>() / count as f64)
    }
}

impl<M: Memory> RolloutState<M> {
    /// Starts an episode in every environment, with a fresh memory of `actor`.
    ///
    /// # Errors
    /// [`RlError::Environment`] when the reset fails, [`RlError::Shape`] when it changes the sizes
    /// of its output, [`RlError::NotFinite`] for vectors that are not numbers.
    pub fn reset<A: Actor<Memory = M>>(
        env: &mut dyn VectorEnv,
        actor: &A,
    ) -> Result<Self, RlError> {
        let spec = env.spec().clone();
        spec.check()?;
        let mut observations = Observations::new(&spec);
        env.reset(&mut observations).map_err(RlError::Environment)?;
        observations.check(&spec, spec.num_envs)?;
        let finite = observations.check_finite(&spec);
        finite.map_err(|error| error.at_step(|_| Some(0)))?;
        Ok(Self {
            observations,
            episodes: (0..spec.num_envs).map(fresh).collect(),
            memory: actor.memory(spec.num_envs),
        })
    }

    /// Tells the memory of the actions `[N, A]` that were executed and of their rewards.
    pub(crate) fn remember(&mut self, actions: &[f32], rewards: &[f32]) {
        let width = actions.len() / rewards.len().max(1);
        for (n, (action, &reward)) in actions.chunks(width.max(1)).zip(rewards).enumerate() {
            self.memory.remember(n, action, reward);
        }
    }

    /// Books one step and moves on to its observations; returns the episodes that ended, which the
    /// memory has then forgotten.
    pub(crate) fn advance(&mut self, transition: &mut Transition) -> Vec<Episode> {
        std::mem::swap(&mut self.observations, &mut transition.observations);
        let mut ended = Vec::new();
        for (n, episode) in self.episodes.iter_mut().enumerate() {
            episode.length += 1;
            episode.total_reward += f64::from(transition.rewards[n]);
            episode.success |= transition.success[n];
            episode.success_at_end = transition.success_at_end[n];
            if transition.outcomes[n].ended() {
                ended.push(std::mem::replace(episode, fresh(n)));
                self.memory.forget(n);
            }
        }
        ended
    }
}

/// Checks `actions` `[N, A]`, lets the environments execute them in the running `episodes` and
/// checks what they say. A simulation that is given NaN can break for good, so it must not see one.
pub(crate) fn step(
    env: &mut dyn VectorEnv,
    episodes: &[Episode],
    actions: &[f32],
    transition: &mut Transition,
) -> Result<(), RlError> {
    let spec = env.spec();
    let next = |env: usize| episodes.get(env).map(|episode| episode.length + 1);
    let expected = spec.num_envs * spec.action.len();
    check_len("actions", "[N, A]", actions.len(), expected)?;
    check_rows_finite("an action", actions, spec.action.len())
        .map_err(|error| error.at_step(next))?;
    env.step(actions, transition).map_err(RlError::Environment)?;
    let checked = transition.check(env.spec());
    checked.map_err(|error| error.at_step(next))
}

fn fresh(env: usize) -> Episode {
    Episode { env, ..Episode::default() }
}

/// Lets `actor` act in the environments from `state` on, for as many steps as `experience` wants,
/// and fills `experience` with them. Environments restart by themselves.
///
/// Episodes span collections where the same `state` is passed again. Where every collection begins
/// with a reset instead, it must last as long as an episode. A shorter one never sees late states:
/// nothing is learnt of them, and no episode ends, so returns are `None`. `collect` does not know
/// whether a reset came before. Call
/// [`RolloutBuffer::check_horizon`](crate::RolloutBuffer::check_horizon) where one does.
///
/// # Errors
/// [`RlError::Environment`] when a step fails, [`RlError::Shape`] or [`RlError::SpecMismatch`] when
/// environment, actor, state and experience do not fit together, [`RlError::NotFinite`] for
/// rewards, observations, actions or decisions that are not numbers, [`RlError::Setting`] when
/// `experience` wants no steps at all.
///
/// After an error, environments, `state` and `experience` may stand at different steps. Go on from
/// [`RolloutState::reset`].
pub fn collect<A: Actor, E: Experience<A>>(
    env: &mut dyn VectorEnv,
    actor: &mut A,
    experience: &mut E,
    state: &mut RolloutState<A::Memory>,
    rng: &mut ChaCha8Rng,
) -> Result<RolloutStats, RlError> {
    let spec = env.spec().clone();
    let steps = experience.steps();
    require("steps", steps as f32, "at least 1 step", steps > 0)?;
    check_len("episodes", "[N]", state.episodes.len(), spec.num_envs)?;
    state.observations.check(&spec, spec.num_envs)?;
    let mut transition = Transition::new(&spec);
    let mut stats = RolloutStats::default();
    experience.begin(&spec)?;
    for _ in 0..steps {
        let (memory, observations) = (&mut state.memory, &state.observations);
        let actions = experience.decide(actor, observations, memory, rng)?;
        step(env, &state.episodes, actions, &mut transition)?;
        state.remember(actions, &transition.rewards);
        experience.record(actor, &state.observations, &transition)?;
        let ended = state.advance(&mut transition);
        stats.count_step(&ended, &state.episodes);
        stats.episodes.extend(ended);
    }
    experience.end(actor, &state.observations)?;
    Ok(stats)
}

/// Experience with an actor: a rollout that an update uses up, or a replay that grows.
///
/// [`collect`] calls `begin`; then, [`Experience::steps`] times, `decide`, one step
/// of the environments and `record`; then `end`.
pub trait Experience<A: Actor> {
    /// Steps of every environment in one collection, at least 1.
    fn steps(&self) -> usize;

    /// Prepares for steps of the environments of `spec`. A rollout forgets the one before, a replay
    /// keeps what it holds.
    ///
    /// # Errors
    /// [`RlError::SpecMismatch`] for other environments than it was made for.
    fn begin(&mut self, spec: &EnvSpec) -> Result<(), RlError>;

    /// Room for the actions `[N, A]` of the next step, and whether that step belongs to a warm-up,
    /// in which actions are drawn uniformly from [-1, 1].
    fn action_buffer(&mut self) -> (&mut [f32], bool);

    /// Lets `actor` choose, keeps what the algorithm needs to know of the choice, and returns the
    /// actions `[N, A]`. Unless it is said otherwise, the actions alone are kept; in a warm-up the
    /// actor is asked, too.
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
        actor.act(observations, memory, rng, actions)?;
        if warm_up {
            actions.fill_with(|| rng.random_range(-1.0..=1.0));
        }
        Ok(actions)
    }

    /// Keeps the step that the last actions led to: `from` what was seen `to` what came of it.
    ///
    /// # Errors
    /// Errors of the actor, or an array that does not fit.
    fn record(
        &mut self,
        actor: &mut A,
        from: &Observations,
        to: &Transition,
    ) -> Result<(), RlError>;

    /// Ends the collection; `last` is what the actor would have acted on next.
    ///
    /// # Errors
    /// Errors of the actor, or an array that does not fit.
    fn end(&mut self, _actor: &mut A, _last: &Observations) -> Result<(), RlError> {
        Ok(())
    }
}

/// Resets the environments and runs the first `rounds` episodes of each with the actor's mean
/// actions.
///
/// Episodes must end, by themselves or by a time limit: an environment that runs for ever is
/// evaluated for ever. Counting the same number of episodes in every environment keeps short
/// episodes from being over-represented.
///
/// # Errors
/// [`RlError::Environment`] when a step fails, [`RlError::Shape`] when environment and actor differ
/// in size, [`RlError::NotFinite`] for rewards, observations or actions that are not numbers.
pub fn evaluate<A: Actor>(
    env: &mut dyn VectorEnv,
    actor: &mut A,
    rounds: usize,
) -> Result<RolloutStats, RlError> {
    evaluate_with(env, actor, rounds, |_, _| Ok(()))
}

/// Evaluates as [`evaluate`] does. Before every decision `look` sees the actor and where the
/// environments stand.
///
/// # Errors
/// Those of [`evaluate`], and of `look`.
pub fn evaluate_with<A: Actor>(
    env: &mut dyn VectorEnv,
    actor: &mut A,
    rounds: usize,
    mut look: impl FnMut(&A, &RolloutState<A::Memory>) -> Result<(), RlError>,
) -> Result<RolloutStats, RlError> {
    let spec = env.spec().clone();
    let mut state = RolloutState::reset(env, actor)?;
    let mut transition = Transition::new(&spec);
    let mut actions = vec![0.0; spec.num_envs * spec.action.len()];
    let mut left = vec![rounds; spec.num_envs];
    let mut stats = RolloutStats::default();
    while left.iter().any(|&rounds| rounds > 0) {
        look(actor, &state)?;
        actor.mean_actions(&state.observations, &mut state.memory, &mut actions)?;
        step(env, &state.episodes, &actions, &mut transition)?;
        state.remember(&actions, &transition.rewards);
        let ended = state.advance(&mut transition);
        stats.count_step(&ended, &state.episodes);
        for episode in ended {
            if left[episode.env] > 0 {
                left[episode.env] -= 1;
                stats.episodes.push(episode);
            }
        }
    }
    Ok(stats)
}

/// Largest magnitude of an episode's return without a warning: beyond it, the gradient of the value
/// function leaves little of the policy's, since both are clipped to one norm.
pub const MAX_RETURN: f64 = 1e3;

/// Smallest magnitude without a warning, but for zero: below it, the errors of a value function
/// that begins to learn are larger than the differences between rewards.
pub const MIN_RETURN: f64 = 1e-2;

/// A return of an episode outside the range in which PPO was seen to learn with its default
/// settings. Nothing in this crate normalises rewards.
///
/// Measured in a task of one step (`tests/reward_scale.rs`), where rewards reach `scale`, after 30
/// rollouts of 512 decisions, as the success of mean actions and of drawn ones:
///
/// | scale | 1e-4 | 1e-3 | 1e-2 | 0.1 | 1 | 10 | 1e2 | 1e3 | 1e4 | 1e5 | 1e6 | 1e7 |
/// |---|---|---|---|---|---|---|---|---|---|---|---|---|
/// | mean | 0.06 | 0.25 | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 | 0.10 |
/// | drawn | 0.11 | 0.16 | 0.45 | 0.89 | 0.90 | 0.84 | 0.37 | 0.36 | 0.34 | 0.24 | 0.16 | 0.13 |
///
/// So learning is best for returns of order 1, and slow at the bounds. A return of zero says
/// nothing: while all rewards are zero, there is no warning. Returns are sums without a discount,
/// so episodes of thousands of steps may exceed the bound although their discounted values do not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RewardWarning {
    /// Returns are beyond [`MAX_RETURN`].
    TooLarge {
        /// Largest magnitude of an episode's return so far.
        largest: f64,
    },
    /// Returns are below [`MIN_RETURN`], though not zero.
    TooSmall {
        /// Largest magnitude of an episode's return so far.
        largest: f64,
    },
}

impl RewardWarning {
    /// Returns the warning for the largest magnitude of an episode's return, if there is one.
    pub fn of(largest: f64) -> Option<Self> {
        if largest > MAX_RETURN {
            Some(Self::TooLarge { largest })
        } else if largest > 0.0 && largest < MIN_RETURN {
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
            Self::TooSmall { largest } => (largest, "little or nothing may be learnt"),
        };
        write!(
            f,
            "returns of episodes reach {largest:.1e} in magnitude, expected between {MIN_RETURN:e} \
             and {MAX_RETURN:e}: {effect}; divide rewards by their usual size in the environment"
        )
    }
}
