//! State of a replay buffer as plain arrays, for checkpoints.

use std::collections::VecDeque;
use std::fmt;

use crate::env::{EnvSpec, Outcome};
use crate::error::{RlError, check_all_finite, check_len};
use crate::replay::episode::{Episode, Sizes};
use crate::replay::{Replay, ReplaySettings, StepIndex};

/// Complete state of a [`Replay`]. A buffer restored from it samples the same steps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReplayState<'a> {
    /// Number of steps ever recorded, dropped ones included.
    pub recorded: u64,
    /// Number of the recorded steps that lie before the mark; all later ones count as newest.
    pub marked: u64,
    /// Index in `episodes` of each environment's running episode, `[N]`; `None` where none is
    /// running.
    pub running: Vec<Option<u32>>,
    /// Index in `episodes` and position in the episode of every held step, the oldest first.
    pub order: Vec<[u32; 2]>,
    /// Stored episodes, in the order in which they began.
    pub episodes: Vec<EpisodeState<'a>>,
}

/// One episode of a [`ReplayState`]: T steps and the T + 1 observations around them. May be empty
/// if none of its steps is held.
#[derive(Clone, Copy, Default, PartialEq)]
pub struct EpisodeState<'a> {
    /// Still channels of the episode's images, `[H, W, S]`.
    pub still: &'a [u8],
    /// Moving channels of the episode's images, `[T + 1, H, W, C - S]`.
    pub moving: &'a [u8],
    /// Observation vectors of the episode, `[T + 1, D]`.
    pub vectors: &'a [f32],
    /// Actions of the episode's steps, `[T, A]`.
    pub actions: &'a [f32],
    /// Rewards of the episode's steps, `[T]`.
    pub rewards: &'a [f32],
    /// State of the episode after its last step.
    pub outcome: Outcome,
    /// Number of steps removed from the front of an episode longer than the buffer.
    pub removed: u32,
}

impl Replay {
    /// Returns the complete state of the replay buffer; arrays are borrowed, not copied.
    pub fn save(&self) -> ReplayState<'_> {
        let index = |number: u32| number - self.first;
        ReplayState {
            recorded: self.recorded,
            marked: self.marked,
            running: self.running.iter().map(|n| n.map(index)).collect(),
            order: self.order.iter().map(|at| [index(at.episode), at.step]).collect(),
            episodes: self.episodes.iter().map(Episode::save).collect(),
        }
    }

    /// Restores a replay buffer from a state that [`Replay::save`] returned.
    ///
    /// # Errors
    /// Errors of [`Replay::new`], [`RlError::Shape`] for arrays of another environment,
    /// [`RlError::Damaged`] or [`RlError::NotFinite`] for invalid numbers.
    pub fn restore(
        settings: ReplaySettings,
        spec: &EnvSpec,
        state: &ReplayState<'_>,
    ) -> Result<Self, RlError> {
        let mut replay = Self::new(settings, spec)?;
        state.check(&replay)?;
        replay.spec.num_envs = state.running.len();
        replay.running.clone_from(&state.running);
        replay.recorded = state.recorded;
        replay.marked = state.marked;
        replay.episodes = state.episodes.iter().map(Episode::restored).collect();
        replay.order = VecDeque::with_capacity(state.order.len());
        for &[episode, step] in &state.order {
            // `restored` starts from 0: the saved order says which steps are held
            replay.episodes[episode as usize].held += 1;
            replay.order.push_back(StepIndex { episode, step });
        }
        Ok(replay)
    }
}

impl Episode {
    fn save(&self) -> EpisodeState<'_> {
        EpisodeState {
            still: &self.still,
            moving: &self.moving,
            vectors: &self.vectors,
            actions: &self.actions,
            rewards: &self.rewards,
            outcome: self.outcome,
            removed: self.removed as u32,
        }
    }

    fn restored(state: &EpisodeState<'_>) -> Self {
        Self {
            still: state.still.to_vec(),
            moving: state.moving.to_vec(),
            vectors: state.vectors.to_vec(),
            actions: state.actions.to_vec(),
            rewards: state.rewards.to_vec(),
            outcome: state.outcome,
            removed: state.removed as usize,
            held: 0,
        }
    }
}

impl fmt::Debug for EpisodeState<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("EpisodeState")
            .field("rewards", &self.rewards)
            .field("outcome", &self.outcome)
            .field("removed", &self.removed)
            .finish_non_exhaustive()
    }
}

impl ReplayState<'_> {
    fn check(&self, replay: &Replay) -> Result<(), RlError> {
        self.episodes.iter().try_for_each(|episode| episode.check(&replay.sizes))?;
        let held = self.recorded.min(replay.settings.capacity as u64);
        let expected = "as many as were recorded, up to the capacity";
        require("replay.order", self.order.len(), expected, |len| {
            len as u64 == held && self.recorded <= u64::from(u32::MAX)
        })?;
        let marked = self.marked as usize;
        let expected_marked = "a number of steps that were recorded";
        require("replay.marked", marked, expected_marked, |_| self.marked <= self.recorded)?;
        self.check_order()?;
        let expected_running = "at least one environment";
        require("replay.running", self.running.len(), expected_running, |n| n > 0)?;
        for (env, &running) in self.running.iter().enumerate() {
            let Some(number) = running else { continue };
            let episode = self.episodes.get(number as usize);
            let runs = episode.is_some_and(|e| !e.outcome.ended() && !e.is_empty());
            let alone = !self.running[..env].contains(&running);
            let expected_episodes = "episodes that have not ended, each of one environment";
            require("replay.running", number as usize, expected_episodes, |_| runs && alone)?;
        }
        Ok(())
    }

    /// Checks that the held steps of an episode are its last ones, each once and in order.
    fn check_order(&self) -> Result<(), RlError> {
        let mut next: Vec<Option<u32>> = vec![None; self.episodes.len()];
        let expected = "the last steps of its episodes, in order";
        for &[episode, step] in &self.order {
            let steps = self.episodes.get(episode as usize).map(EpisodeState::steps);
            let stored = steps.is_some_and(|steps| steps.contains(&step));
            let fits = stored && next[episode as usize].is_none_or(|next| next == step);
            require("replay.order", step as usize, expected, |_| fits)?;
            next[episode as usize] = Some(step + 1);
        }
        for (episode, following) in self.episodes.iter().zip(next) {
            let end = episode.steps().end;
            let whole = following.is_none_or(|following| following == end);
            require("replay.order", end as usize, expected, |_| whole)?;
        }
        Ok(())
    }
}

impl EpisodeState<'_> {
    /// Returns `true` if no observation of the episode is stored.
    pub fn is_empty(&self) -> bool {
        self.still.is_empty() && self.moving.is_empty() && self.vectors.is_empty()
    }

    /// Returns the positions of the stored steps in the episode.
    fn steps(&self) -> std::ops::Range<u32> {
        self.removed..self.removed.saturating_add(self.rewards.len() as u32)
    }

    fn check(&self, sizes: &Sizes) -> Result<(), RlError> {
        let steps = self.rewards.len();
        let most = (u32::MAX - self.removed) as usize;
        require("replay.episode", steps, "fewer than 2^32 steps", |n| n < most)?;
        let frames = if self.is_empty() { 0 } else { steps + 1 };
        let still = frames.min(1) * sizes.still_len();
        let moving = frames * sizes.moving_len();
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

fn require(
    name: &str,
    value: usize,
    expected: &'static str,
    allowed: impl FnOnce(usize) -> bool,
) -> Result<(), RlError> {
    if allowed(value) {
        return Ok(());
    }
    Err(RlError::Damaged { name: name.to_owned(), value: value as f64, expected })
}
