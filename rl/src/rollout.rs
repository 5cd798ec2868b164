//! Collection of experience: T steps of N environments with sampled actions.

use rand_chacha::ChaCha8Rng;

use crate::env::{Observations, Transition, VectorEnv};
use crate::error::{RlError, check_len, check_rows_finite};
use crate::experience::Experience;
use crate::policy::{Actor, Memory};
use crate::require::require;
use crate::reward_scale::RewardWarning;

/// Where N environments stand between two rollouts. The fields are the whole state.
#[derive(Clone, Debug, PartialEq)]
pub struct RolloutState<M = ()> {
    /// What the actor acts on next.
    pub observations: Observations,
    /// The running episodes so far, `[N]`.
    pub episodes: Vec<Episode>,
    /// What the actor remembers of them.
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
    /// Whether the success condition held at any time of the episode.
    pub success: bool,
    /// Whether the success condition held at the end of the last step.
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
    pub(crate) fn book(&mut self, ended: &[Episode], running: &[Episode]) {
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
        finite.map_err(|error| error.at_step(|_| 0))?;
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
    let next = |env: usize| episodes.get(env).map_or(1, |episode| episode.length + 1);
    let expected = spec.num_envs * spec.action.len();
    check_len("actions", "[N, A]", actions.len(), expected)?;
    check_rows_finite("an action", actions, spec.action.len())
        .map_err(|error| error.at_step(next))?;
    env.step(actions, transition)
        .map_err(RlError::Environment)?;
    let checked = transition.check(env.spec());
    checked.map_err(|error| error.at_step(next))
}

fn fresh(env: usize) -> Episode {
    Episode {
        env,
        ..Episode::default()
    }
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
        stats.book(&ended, &state.episodes);
        stats.episodes.extend(ended);
    }
    experience.end(actor, &state.observations)?;
    Ok(stats)
}
