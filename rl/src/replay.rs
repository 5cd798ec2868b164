//! Replay buffer: a ring buffer of recorded steps.

mod episode;
pub(crate) mod state;

use std::collections::VecDeque;
use std::fmt;
use std::iter::repeat_n;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::env::{EnvSpec, Observations, StepOutcome, Transition};
use crate::error::{RlError, check_len, check_rows_finite, require};
use crate::policy::Actor;
use crate::replay::episode::{Episode, Sizes};
use crate::rollout::ExperienceBuffer;

/// Replay buffer: a ring buffer of the latest steps, in the order in which they were recorded.
///
/// Images are stored as bytes. An episode's observations are stored consecutively, so that each is
/// stored once, although it ends one step and begins the next; still channels
/// ([`ReplaySettings::still_channels`]) are stored once for each episode. Dropped steps stay in
/// memory while they are [history](ReplayStep::nth_step_before) of later ones of their episode.
///
/// [`collect_experience`](crate::collect_experience) fills it; [`ReplayBuffer::push`] does the same
/// by hand.
#[derive(Clone)]
pub struct ReplayBuffer {
    settings: ReplaySettings,
    spec: EnvSpec,
    sizes: Sizes,
    stored_episodes: VecDeque<Episode>,
    /// Number of the first episode in `stored_episodes`; episodes are numbered in the order in
    /// which they began.
    first_episode: u32,
    /// Identifiers of the steps that the buffer holds, the oldest first.
    step_order: VecDeque<StepId>,
    /// Number of each environment's running episode, `[N]`; `None` if the environment's next step
    /// begins an episode.
    running_episodes: Vec<Option<u32>>,
    total_recorded_steps: u64,
    num_before_newest: u64,
    /// Image arrays of dropped episodes, at most N, whose memory new episodes reuse. Returning them
    /// to the allocator instead fragments the memory, since they are large and of almost equal
    /// size: a fifth of the memory was lost after a few rounds.
    spare_images: Vec<Vec<u8>>,
    /// Actions of the step that is being collected, `[N, A]`.
    actions: Vec<f32>,
}

impl ReplayBuffer {
    /// Creates an empty replay buffer for the environments of `spec`; their number may change, see
    /// [`ReplayBuffer::cut_running_episodes`]. Memory is allocated as steps are recorded.
    ///
    /// # Errors
    /// [`RlError::EmptySpec`] or [`RlError::InvalidSetting`] for sizes out of range.
    pub fn new(settings: ReplaySettings, spec: &EnvSpec) -> Result<Self, RlError> {
        spec.check()?;
        settings.check(spec)?;
        Ok(Self {
            sizes: Sizes::new(spec, settings.still_channels),
            settings,
            spec: spec.clone(),
            stored_episodes: VecDeque::new(),
            first_episode: 0,
            step_order: VecDeque::new(),
            running_episodes: vec![None; spec.num_envs],
            total_recorded_steps: 0,
            num_before_newest: 0,
            spare_images: Vec::new(),
            actions: Vec::new(),
        })
    }

    /// Records one step of N environments: the observations before it, the actions `[N, A]` and the
    /// transition. After an error, nothing has changed.
    ///
    /// # Errors
    /// [`RlError::ShapeMismatch`] when an array does not fit, [`RlError::NotFinite`] for infinite
    /// or NaN numbers, [`RlError::EpisodeNotContinued`] for observations other than those the last
    /// step led to, [`RlError::StillChannelChanged`] if a still channel changes.
    pub fn push(
        &mut self,
        observations: &Observations,
        actions: &[f32],
        transition: &Transition,
    ) -> Result<(), RlError> {
        let n = self.spec.num_envs;
        observations.check_lengths(&self.spec, n)?;
        observations.check_finite(&self.spec)?;
        check_len("actions", "[N, A]", actions.len(), n * self.sizes.action)?;
        check_rows_finite("an action", actions, self.sizes.action)?;
        transition.check(&self.spec)?;
        // all environments before the first push, so that an error leaves the buffer unchanged
        (0..n).try_for_each(|env| self.check_continued(env, observations, transition))?;
        for env in 0..n {
            let action = &actions[env * self.sizes.action..(env + 1) * self.sizes.action];
            self.push_one(env, observations, action, transition);
        }
        Ok(())
    }

    /// Cuts the running episodes: the next observations start new ones, and the last steps still
    /// count as [`StepOutcome::Running`]. Call it before a collection that begins with a reset.
    /// Afterwards, a collection may have another number of environments.
    pub fn cut_running_episodes(&mut self) {
        for number in self.running_episodes.iter_mut().filter_map(Option::take) {
            if let Some(episode) =
                self.stored_episodes.get_mut((number - self.first_episode) as usize)
            {
                episode.shrink_to_fit();
            }
        }
    }

    /// Starts the newest experience, to which all steps recorded from now on belong:
    /// [`ReplayBuffer::sample_indices`] takes a share of its steps from it. Before the first call,
    /// all steps count as newest.
    pub fn mark_newest_from_now(&mut self) {
        self.mark_newest_steps(0);
    }

    /// Marks the last `steps` steps (all, if there are fewer) as the newest experience.
    pub fn mark_newest_steps(&mut self, steps: u64) {
        self.num_before_newest = self.total_recorded_steps.saturating_sub(steps);
    }

    /// Samples the indices of `batch` steps with replacement: a share `newest` in [0, 1], rounded,
    /// from the newest experience ([`ReplayBuffer::mark_newest_from_now`]), the others from all
    /// steps. If there is no newest experience, all are drawn from all steps.
    ///
    /// # Panics
    /// If the buffer is empty, or `newest` is outside [0, 1].
    pub fn sample_indices(
        &self,
        batch: usize,
        newest: f32,
        rng: &mut ChaCha8Rng,
        out: &mut Vec<usize>,
    ) {
        assert!((0.0..=1.0).contains(&newest), "newest is {newest}, expected a share in [0, 1]");
        let len = self.len();
        let since = ((self.total_recorded_steps - self.num_before_newest) as usize).min(len);
        let share = (f64::from(newest) * batch as f64).round() as usize;
        let starts = if since == 0 { 0 } else { len - since };
        let starts = repeat_n(starts, share).chain(repeat_n(0, batch - share));
        out.clear();
        out.extend(starts.map(|start| rng.random_range(start..len)));
    }

    /// Returns the step at `index`, in 0..[`ReplayBuffer::len`]; the oldest step has index 0.
    ///
    /// # Panics
    /// If there is no such step.
    pub fn get(&self, index: usize) -> ReplayStep<'_> {
        let step_id = self.step_order[index];
        let episode = self.episode(step_id.episode);
        ReplayStep {
            episode,
            sizes: &self.sizes,
            number: step_id.episode,
            step: step_id.step as usize - episode.removed,
        }
    }

    /// Returns the number of steps that the replay buffer holds.
    pub fn len(&self) -> usize {
        self.step_order.len()
    }

    /// Returns `true` if the replay buffer holds no step.
    pub fn is_empty(&self) -> bool {
        self.step_order.is_empty()
    }

    /// Returns the number of steps ever recorded, dropped ones included.
    pub fn total_recorded_steps(&self) -> u64 {
        self.total_recorded_steps
    }

    /// Returns the settings of the replay buffer.
    pub fn settings(&self) -> &ReplaySettings {
        &self.settings
    }

    /// Returns the sizes and symmetry types of the environments whose steps the buffer records.
    pub fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    /// Returns the number of bytes that the replay buffer has allocated.
    pub fn allocated_bytes(&self) -> usize {
        let episodes = self.stored_episodes.iter().map(Episode::allocated_bytes).sum::<usize>();
        let spare = self.spare_images.iter().map(Vec::capacity).sum::<usize>();
        episodes + spare + self.step_order.capacity() * size_of::<StepId>()
    }

    fn episode(&self, number: u32) -> &Episode {
        &self.stored_episodes[(number - self.first_episode) as usize]
    }

    /// Rejects a step of environment `env` that does not continue its running episode, and images
    /// whose still channels change.
    fn check_continued(
        &self,
        env: usize,
        observations: &Observations,
        transition: &Transition,
    ) -> Result<(), RlError> {
        let (image, vector) = observations.image_and_vector(&self.spec, env);
        let (next_image, _) = next_observations(transition, env).image_and_vector(&self.spec, env);
        let begun;
        let episode = match self.running_episodes[env] {
            Some(number) => self.episode(number),
            None => {
                begun = Episode::begin(&self.sizes, image, vector, Vec::new());
                &begun
            }
        };
        if !episode.last_observation_equals(&self.sizes, image, vector) {
            return Err(RlError::EpisodeNotContinued { env });
        }
        if !episode.has_same_still_channels(&self.sizes, next_image) {
            let channels = self.sizes.still;
            return Err(RlError::StillChannelChanged { env, channels });
        }
        Ok(())
    }

    fn push_one(
        &mut self,
        env: usize,
        observations: &Observations,
        action: &[f32],
        transition: &Transition,
    ) {
        let number = self.running_episodes[env].unwrap_or_else(|| {
            let (image, vector) = observations.image_and_vector(&self.spec, env);
            let spare = self.spare_images.pop().unwrap_or_default();
            self.stored_episodes.push_back(Episode::begin(&self.sizes, image, vector, spare));
            self.first_episode + self.stored_episodes.len() as u32 - 1
        });
        let (reward, outcome) = (transition.rewards[env], transition.outcomes[env]);
        let (image, vector) = next_observations(transition, env).image_and_vector(&self.spec, env);
        let episode = &mut self.stored_episodes[(number - self.first_episode) as usize];
        self.step_order.push_back(StepId {
            episode: number,
            step: (episode.removed + episode.num_steps()) as u32,
        });
        episode.push(&self.sizes, action, reward, outcome, image, vector);
        self.running_episodes[env] = (!outcome.is_ended()).then_some(number);
        self.total_recorded_steps += 1;
        if self.len() > self.settings.capacity {
            self.drop_oldest();
        }
    }

    /// Drops the oldest step of the buffer, and frees ended episodes of which no step is held any
    /// more.
    fn drop_oldest(&mut self) {
        let Some(step_id) = self.step_order.pop_front() else {
            return;
        };
        let running = &self.running_episodes;
        let over = |number: u32| !running.contains(&Some(number));
        let episode = &mut self.stored_episodes[(step_id.episode - self.first_episode) as usize];
        episode.drop_oldest_step(&self.sizes);
        if episode.num_held == 0 && over(step_id.episode) {
            let dropped = std::mem::take(episode);
            if self.spare_images.len() < self.running_episodes.len() {
                self.spare_images.push(dropped.moving);
            }
        }
        // episodes do not end in the order in which they began, so one that is over may have to
        // wait for those before it
        while self.stored_episodes.front().is_some_and(|e| e.num_held == 0)
            && over(self.first_episode)
        {
            self.stored_episodes.pop_front();
            self.first_episode += 1;
        }
    }
}

impl fmt::Debug for ReplayBuffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ReplayBuffer")
            .field("settings", &self.settings)
            .field("spec", &self.spec)
            .field("len", &self.len())
            .field("recorded", &self.total_recorded_steps)
            .finish_non_exhaustive()
    }
}

/// Returns the observations after a step of environment `env`: the final ones if the episode ended.
fn next_observations(transition: &Transition, env: usize) -> &Observations {
    match transition.outcomes[env] {
        StepOutcome::Running => &transition.observations,
        StepOutcome::Terminated | StepOutcome::Truncated => &transition.final_observations,
    }
}

impl<A: Actor> ExperienceBuffer<A> for ReplayBuffer {
    fn steps_per_env(&self) -> usize {
        self.settings.steps
    }

    /// Adapts the buffer to the number of environments of `spec`, which may change only between
    /// episodes.
    fn begin(&mut self, spec: &EnvSpec) -> Result<(), RlError> {
        self.spec.check_compatible(spec)?;
        let (got, expected) = (spec.num_envs, self.spec.num_envs);
        if self.running_episodes.iter().any(Option::is_some) {
            check_len("environments", "[N]", got, expected)?;
        }
        self.spec.num_envs = got;
        self.running_episodes.resize(got, None);
        self.actions.resize(got * self.sizes.action, 0.0);
        Ok(())
    }

    fn action_buffer(&mut self) -> (&mut [f32], bool) {
        let warm_up = self.total_recorded_steps < self.settings.warm_up;
        (&mut self.actions, warm_up)
    }

    fn record(&mut self, _: &mut A, from: &Observations, to: &Transition) -> Result<(), RlError> {
        // taken out for the call, since `push` borrows the whole buffer mutably
        let actions = std::mem::take(&mut self.actions);
        let result = self.push(from, &actions, to);
        self.actions = actions;
        result
    }
}

/// Identifier of a recorded step, and of the observation for which its action was chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct StepId {
    /// Number of the episode that the step belongs to; episodes are numbered in the order in which
    /// they began.
    pub episode: u32,
    /// Position of the step in its episode, from 0.
    pub step: u32,
}

/// A step in a [`ReplayBuffer`]: an observation, the action, the reward and the next observation.
#[derive(Clone, Copy)]
pub struct ReplayStep<'a> {
    episode: &'a Episode,
    sizes: &'a Sizes,
    /// Number of the step's episode, in the order in which episodes began.
    number: u32,
    /// Position of the step among the stored steps of its episode.
    step: usize,
}

impl<'a> ReplayStep<'a> {
    /// Returns the position of the step in its episode, from 0.
    pub fn index_in_episode(&self) -> usize {
        self.episode.removed + self.step
    }

    /// Returns the identifier of the step and of the observation before it.
    pub(crate) fn index(&self) -> StepId {
        StepId { episode: self.number, step: self.index_in_episode() as u32 }
    }

    /// Returns the identifier of the observation after the step.
    pub(crate) fn next_index(&self) -> StepId {
        let StepId { episode, step } = self.index();
        StepId { episode, step: step + 1 }
    }

    /// Writes the image `[H, W, C]` before the step, for which the action was chosen, to `out`.
    ///
    /// # Panics
    /// If the length of `out` is not that of an image.
    pub fn write_image(&self, out: &mut [u8]) {
        self.episode.write_image(self.sizes, self.step, out);
    }

    /// Returns the observation vector `[D]` before the step, for which the action was chosen.
    pub fn observation_vector(&self) -> &'a [f32] {
        row(&self.episode.vectors, self.step, self.sizes.vector)
    }

    /// Returns the action `[A]` executed in this step.
    pub fn action(&self) -> &'a [f32] {
        row(&self.episode.actions, self.step, self.sizes.action)
    }

    /// Returns the reward of the step.
    pub fn reward(&self) -> f32 {
        self.episode.rewards[self.step]
    }

    /// Returns the state of the episode after the step. After
    /// [`ReplayBuffer::cut_running_episodes`](crate::ReplayBuffer::cut_running_episodes), an
    /// episode's last step stays [`StepOutcome::Running`].
    pub fn outcome(&self) -> StepOutcome {
        if self.step + 1 == self.episode.num_steps() {
            self.episode.outcome
        } else {
            StepOutcome::Running
        }
    }

    /// Writes the image `[H, W, C]` observed after the step to `out`; where the episode ends, its
    /// final image.
    ///
    /// # Panics
    /// If the length of `out` is not that of an image.
    pub fn write_next_image(&self, out: &mut [u8]) {
        self.episode.write_image(self.sizes, self.step + 1, out);
    }

    /// Returns the observation vector `[D]` after the step; where the episode ends, its final
    /// vector.
    pub fn next_observation_vector(&self) -> &'a [f32] {
        row(&self.episode.vectors, self.step + 1, self.sizes.vector)
    }

    /// Returns the step `count` steps before this one in its episode; `None` if the episode begins
    /// later or that step is no longer stored. At least 256 dropped steps of an episode longer than
    /// the buffer's capacity remain available.
    pub fn nth_step_before(&self, count: usize) -> Option<Self> {
        let step = self.step.checked_sub(count)?;
        Some(Self { step, ..*self })
    }

    /// Returns the step `count` steps later among those of the episode that the buffer holds, in a
    /// circle: the first of them follows the last. The wrap-around makes the result uniformly
    /// distributed if this step is.
    pub(crate) fn wrapping_later(&self, count: usize) -> Self {
        let first = self.episode.num_steps() - self.episode.num_held;
        let step = first + (self.step - first + count) % self.episode.num_held;
        Self { step, ..*self }
    }
}

impl fmt::Debug for ReplayStep<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ReplayStep")
            .field("index", &self.index())
            .field("action", &self.action())
            .field("reward", &self.reward())
            .field("outcome", &self.outcome())
            .finish_non_exhaustive()
    }
}

fn row(values: &[f32], i: usize, width: usize) -> &[f32] {
    &values[i * width..(i + 1) * width]
}

/// Settings of [`crate::ReplayBuffer`]. Default capacity and warm-up follow CLEAR and 3RL in COVERS
/// (Liu et al., CoRL 2023, appendix, table "CLEAR and 3RL Hyperparameter").
///
/// In a file, a field that is missing has its default, and one that does not exist is an error.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReplaySettings {
    /// Maximum number of steps that the buffer holds, at least 1; beyond it, every new step
    /// replaces the oldest.
    pub capacity: usize,
    /// Number of steps of every environment in one collection, at least 1.
    pub steps: usize,
    /// Number of initial decisions whose actions are drawn uniformly from [-1, 1].
    pub warm_up: u64,
    /// Number of channels, the last ones of an image, that stay the same during an episode. They
    /// are stored once for each episode.
    pub still_channels: usize,
}

impl Default for ReplaySettings {
    fn default() -> Self {
        Self { capacity: 200_000, steps: 50, warm_up: 1000, still_channels: 0 }
    }
}

impl ReplaySettings {
    /// Checks that every setting of the replay buffer is in its range, and that images have at
    /// least as many channels as are declared still.
    ///
    /// # Errors
    /// [`RlError::InvalidSetting`] names the field, its value and its range.
    pub fn check(&self, spec: &EnvSpec) -> Result<(), RlError> {
        // steps are numbered by u32
        let allowed_capacities = 1..=u32::MAX as usize;
        let (capacity, still) = (self.capacity, self.still_channels);
        let allowed = allowed_capacities.contains(&capacity);
        require("capacity", capacity as f32, "1 to 2^32 - 1 steps", allowed)?;
        let has_steps = self.steps > 0;
        require("steps", self.steps as f32, "at least 1 step", has_steps)?;
        if self.warm_up > 0 {
            spec.require_continuous("a warm-up of random actions")?;
        }
        let expected = "at most the channels of an image";
        let has_channels = still <= spec.image_shape[2];
        require("still_channels", still as f32, expected, has_channels)
    }
}
