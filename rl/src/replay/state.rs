//! State of a replay buffer as plain arrays, for checkpoints.

use std::collections::VecDeque;
use std::fmt;

use crate::env::{EnvSpec, StepOutcome};
use crate::error::{RlError, check_all_finite, check_len, require_saved};
use crate::replay::episode::{Episode, Sizes};
use crate::replay::{ReplayBuffer, ReplaySettings, StepId};

/// Complete state of a [`ReplayBuffer`]. A buffer restored from it samples the same steps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReplayState<'a> {
    /// Number of steps ever recorded, dropped ones included.
    pub total_recorded_steps: u64,
    /// Number of recorded steps older than the newest experience
    /// ([`ReplayBuffer::mark_newest_from_now`]).
    pub num_before_newest: u64,
    /// Index in `stored_episodes` of each environment's running episode, `[N]`; `None` where none
    /// is running.
    pub running_episodes: Vec<Option<u32>>,
    /// Index of the episode in `stored_episodes` and position in the episode of every step that the
    /// buffer holds, the oldest first.
    pub step_order: Vec<[u32; 2]>,
    /// Stored episodes, in the order in which they began.
    pub stored_episodes: Vec<StoredEpisode<'a>>,
}

/// One episode of a [`ReplayState`]: T steps and the T + 1 observations around them. May be empty
/// if the buffer holds none of its steps.
#[derive(Clone, Copy, Default, PartialEq)]
pub struct StoredEpisode<'a> {
    /// Still channels of the episode's images, `[H, W, S]` for S channels that do not change in an
    /// episode.
    pub still: &'a [u8],
    /// Moving channels of the episode's images, `[T + 1, H, W, C - S]` for S still ones of C
    /// channels.
    pub moving: &'a [u8],
    /// Observation vectors of the episode, `[T + 1, D]`.
    pub vectors: &'a [f32],
    /// Actions of the episode's steps, `[T, A]`.
    pub actions: &'a [f32],
    /// Rewards of the episode's steps, `[T]`.
    pub rewards: &'a [f32],
    /// State of the episode after its last step.
    pub outcome: StepOutcome,
    /// Number of steps removed from the front of an episode longer than the buffer.
    pub removed: u32,
}

impl ReplayBuffer {
    /// Returns the complete state of the replay buffer; arrays are borrowed, not copied.
    pub fn checkpoint_state(&self) -> ReplayState<'_> {
        let index = |number: u32| number - self.first_episode;
        ReplayState {
            total_recorded_steps: self.total_recorded_steps,
            num_before_newest: self.num_before_newest,
            running_episodes: self.running_episodes.iter().map(|n| n.map(index)).collect(),
            step_order: self.step_order.iter().map(|at| [index(at.episode), at.step]).collect(),
            stored_episodes: self.stored_episodes.iter().map(Episode::save).collect(),
        }
    }

    /// Restores a replay buffer from a state that [`ReplayBuffer::checkpoint_state`] returned.
    ///
    /// # Errors
    /// Errors of [`ReplayBuffer::new`], [`RlError::ShapeMismatch`] for arrays of another
    /// environment, [`RlError::InvalidStateNumber`] or [`RlError::NotFinite`] for invalid numbers.
    pub fn restore(
        settings: ReplaySettings,
        spec: &EnvSpec,
        state: &ReplayState<'_>,
    ) -> Result<Self, RlError> {
        let mut replay = Self::new(settings, spec)?;
        state.check(&replay)?;
        replay.spec.num_envs = state.running_episodes.len();
        replay.running_episodes.clone_from(&state.running_episodes);
        replay.total_recorded_steps = state.total_recorded_steps;
        replay.num_before_newest = state.num_before_newest;
        replay.stored_episodes = state.stored_episodes.iter().map(Episode::restored).collect();
        replay.step_order = VecDeque::with_capacity(state.step_order.len());
        for &[episode, step] in &state.step_order {
            // `restored` starts from 0: the saved order says which steps are held
            replay.stored_episodes[episode as usize].num_held += 1;
            replay.step_order.push_back(StepId { episode, step });
        }
        Ok(replay)
    }
}

impl Episode {
    fn save(&self) -> StoredEpisode<'_> {
        StoredEpisode {
            still: &self.still,
            moving: &self.moving,
            vectors: &self.vectors,
            actions: &self.actions,
            rewards: &self.rewards,
            outcome: self.outcome,
            removed: self.removed as u32,
        }
    }

    fn restored(state: &StoredEpisode<'_>) -> Self {
        Self {
            still: state.still.to_vec(),
            moving: state.moving.to_vec(),
            vectors: state.vectors.to_vec(),
            actions: state.actions.to_vec(),
            rewards: state.rewards.to_vec(),
            outcome: state.outcome,
            removed: state.removed as usize,
            num_held: 0,
        }
    }
}

impl fmt::Debug for StoredEpisode<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("StoredEpisode")
            .field("rewards", &self.rewards)
            .field("outcome", &self.outcome)
            .field("removed", &self.removed)
            .finish_non_exhaustive()
    }
}

impl ReplayState<'_> {
    fn check(&self, replay: &ReplayBuffer) -> Result<(), RlError> {
        self.stored_episodes.iter().try_for_each(|episode| episode.check(&replay.sizes))?;
        let held = self.total_recorded_steps.min(replay.settings.capacity as u64);
        let expected = "as many as were recorded, up to the capacity";
        let len = self.step_order.len() as u64;
        let complete = len == held;
        require_saved("replay.order", len as f64, expected, complete)?;
        let marked = self.num_before_newest;
        let expected_marked = "a number of steps that were recorded";
        let recorded = marked <= self.total_recorded_steps;
        require_saved("replay.marked", marked as f64, expected_marked, recorded)?;
        self.check_order()?;
        let expected_running = "at least one environment";
        let envs = self.running_episodes.len();
        require_saved("replay.running", envs as f64, expected_running, envs > 0)?;
        for (env, &running) in self.running_episodes.iter().enumerate() {
            let Some(number) = running else { continue };
            let episode = self.stored_episodes.get(number as usize);
            let runs = episode.is_some_and(|e| !e.outcome.is_ended() && !e.is_empty());
            let alone = !self.running_episodes[..env].contains(&running);
            let expected_episodes = "episodes that have not ended, each of one environment";
            require_saved("replay.running", number.into(), expected_episodes, runs && alone)?;
        }
        Ok(())
    }

    /// Checks that the steps that the buffer holds of each episode are its last ones, each once and
    /// in order.
    fn check_order(&self) -> Result<(), RlError> {
        let mut next: Vec<Option<u32>> = vec![None; self.stored_episodes.len()];
        let expected = "the last steps of its episodes, in order";
        for &[episode, step] in &self.step_order {
            let steps = self.stored_episodes.get(episode as usize).map(StoredEpisode::steps);
            let stored = steps.is_some_and(|steps| steps.contains(&step));
            let fits = stored && next[episode as usize].is_none_or(|next| next == step);
            require_saved("replay.order", step.into(), expected, fits)?;
            next[episode as usize] = Some(step + 1);
        }
        for (episode, following) in self.stored_episodes.iter().zip(next) {
            let end = episode.steps().end;
            let whole = following.is_none_or(|following| following == end);
            require_saved("replay.order", end.into(), expected, whole)?;
        }
        Ok(())
    }
}

impl StoredEpisode<'_> {
    /// Returns `true` if no observation of the episode is stored.
    pub fn is_empty(&self) -> bool {
        self.still.is_empty() && self.moving.is_empty() && self.vectors.is_empty()
    }

    /// Returns the range of positions that the stored steps have in the episode.
    fn steps(&self) -> std::ops::Range<u32> {
        self.removed..self.removed.saturating_add(self.rewards.len() as u32)
    }

    fn check(&self, sizes: &Sizes) -> Result<(), RlError> {
        let steps = self.rewards.len();
        let most = (u32::MAX - self.removed) as usize;
        require_saved("replay.episode", steps as f64, "fewer than 2^32 steps", steps < most)?;
        let frames = if self.is_empty() { 0 } else { steps + 1 };
        let still = frames.min(1) * sizes.still_channels_len();
        let moving = frames * sizes.moving_channels_len();
        check_len("still", "[H, W, S]", self.still.len(), still)?;
        check_len("moving", "[T + 1, H, W, C - S]", self.moving.len(), moving)?;
        let vectors = frames * sizes.vector;
        check_len("vectors", "[T + 1, D]", self.vectors.len(), vectors)?;
        let actions = frames.saturating_sub(1) * sizes.action;
        check_len("actions", "[T, A]", self.actions.len(), actions)?;
        check_len("rewards", "[T]", steps, frames.saturating_sub(1))?;
        check_all_finite("a saved vector", self.vectors)?;
        check_all_finite("a saved action", self.actions)?;
        check_all_finite("a saved reward", self.rewards)
    }
}
