//! Task stream as an environment. Groups change and return, and the learner is not informed.

use std::time::Instant;

use envs::{
    ControlSettings, EnvError, EnvFailure, ObservationsMut, StepResultsMut, TaskGroup, VecEnv,
    VecEnvSettings,
};
use rl::{BoxedEnvError, EnvSpec, Observations, ProcessRanks, StepOutcome, Transition, VectorEnv};
use symmetry::D2;

use crate::error::RunError;
use crate::stop::StopSignal;

const PERFECT_EPISODE: f64 = 500.0;
/// Largest number of causes of failures that are kept until they are taken.
const MAX_FAILURE_CAUSES: usize = 10;
/// Factor from positions (metres) to network inputs, which makes them numbers of order one.
const INPUTS_PER_METRE: f32 = 10.0;
/// Height of the hand (metres) that becomes the network input 0, about the middle of its range.
const MIDDLE_HEIGHT: f32 = 0.2;
/// Opening of the fingers, in `[0, 1]`, that becomes the network input 0, about its middle value.
const MIDDLE_APERTURE: f32 = 0.6;

/// Name, unit and scaling, `(value - offset) * factor`, of a component of the network's vector
/// input.
pub struct InputScaling {
    pub name: &'static str,
    pub unit: &'static str,
    pub offset: f32,
    pub factor: f32,
}

/// Names, units and scaling of the components of the network's vector input, in order. Components
/// that change sign under a flip have offset 0, so scaling preserves flips; so have goals, whose
/// zero means hidden.
pub const VECTOR_INPUT_SCALING: [InputScaling; envs::VECTOR_OBSERVATION_DIM] = [
    position("hand x", 0.0),
    position("hand y", 0.0),
    position("hand z", MIDDLE_HEIGHT),
    InputScaling {
        name: "aperture",
        unit: "share of the fingers' opening",
        offset: MIDDLE_APERTURE,
        factor: 1.0,
    },
    position("goal x", 0.0),
    position("goal y", 0.0),
    position("goal z", 0.0),
    position("lead x", 0.0),
    position("lead y", 0.0),
    position("lead z", 0.0),
];

const fn position(name: &'static str, offset: f32) -> InputScaling {
    InputScaling { name, unit: "metre", offset, factor: INPUTS_PER_METRE }
}

/// Vectorised environments of a run as the learner sees them, with scaled observation vectors. The
/// task group is set from outside and shows only in the observations.
pub struct SwitchableVecEnv {
    env: VecEnv,
    spec: EnvSpec,
    truncated: Vec<bool>,
    failures: usize,
    failure_causes: Vec<String>,
    seconds: f64,
    stop: StopSignal,
    ranks: ProcessRanks,
}

impl SwitchableVecEnv {
    /// Creates environments of the first of `groups`, with variants drawn from all four elements.
    /// The other groups are prepared, so that a later switch takes no time.
    ///
    /// # Errors
    /// [`RunError::InvalidSetting`] if `groups` is empty; errors of the environments.
    pub fn new(settings: VecEnvSettings, groups: &[TaskGroup]) -> Result<Self, RunError> {
        Self::on_ranks(settings, groups, ProcessRanks::default())
    }

    /// Creates environments as [`SwitchableVecEnv::new`] does; each of the processes `ranks` steps
    /// a share.
    ///
    /// # Errors
    /// As [`SwitchableVecEnv::new`].
    pub fn on_ranks(
        settings: VecEnvSettings,
        groups: &[TaskGroup],
        ranks: ProcessRanks,
    ) -> Result<Self, RunError> {
        let first = *groups
            .first()
            .ok_or_else(|| RunError::invalid("groups", "empty", "at least one task group"))?;
        let share = ranks.local_range(settings.num_envs);
        let mut env = VecEnv::new_shard(settings, first, &D2::ALL, share)?;
        env.prepare_task_groups(groups)?;
        Ok(Self {
            env,
            spec: Self::env_spec(&settings),
            truncated: vec![false; settings.num_envs],
            failures: 0,
            failure_causes: Vec::new(),
            seconds: 0.0,
            stop: StopSignal::default(),
            ranks,
        })
    }

    /// Sets the signal after which every step is an error.
    pub(crate) fn set_stop_signal(&mut self, stop: StopSignal) {
        self.stop = stop;
    }

    /// Returns the shapes of observations and actions of environments with these settings, without
    /// starting any.
    pub fn env_spec(settings: &VecEnvSettings) -> EnvSpec {
        let size = settings.camera.size;
        EnvSpec {
            num_envs: settings.num_envs,
            image_shape: [size, size, settings.camera.extra_views.num_total_channels()],
            vector_irreps: envs::VECTOR_OBSERVATION_IRREPS.to_vec(),
            action_irreps: envs::ACTION_IRREPS.to_vec(),
            choices: vec![],
        }
    }

    /// Switches the environments to another task group, with variants drawn from `elements`, from
    /// the next reset on.
    ///
    /// # Errors
    /// Errors of the environments.
    pub fn switch_task_group(&mut self, group: TaskGroup, elements: &[D2]) -> Result<(), EnvError> {
        self.env.set_task_group(group, elements)
    }

    /// Draws placements and variants from now on from the random streams of `seed`; see
    /// [`VecEnv::reseed`].
    ///
    /// # Errors
    /// Errors of the environments.
    pub fn reseed(&mut self, seed: u64) -> Result<(), EnvError> {
        self.env.reseed(seed)
    }

    /// Returns the wall-clock seconds that resets and steps of the environments took so far.
    pub fn environment_seconds(&self) -> f64 {
        self.seconds
    }

    /// Returns the number of failures of single environments so far. Each ended an episode, as a
    /// truncation for the learner.
    pub fn environment_failures(&self) -> usize {
        self.failures
    }

    /// Returns the factor from a return, a sum of rewards in `[0, 1]`, to the paper's scale, on
    /// which a perfect episode earns 500.
    pub fn reward_scale(&self) -> f64 {
        reward_scale(&self.env.settings().control)
    }

    /// Returns the causes of failures of this rank's environments since the last call, of many the
    /// first ten.
    pub fn take_failure_causes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.failure_causes)
    }

    /// Records the causes of failures in the environments of this rank, and counts them together
    /// with those of others.
    fn record_failures(&mut self, causes: Vec<String>) {
        let counts = self.ranks.all_gather_numbers(causes.len() as u64);
        self.failures += counts.iter().sum::<u64>() as usize;
        self.failure_causes.extend(causes);
        self.failure_causes.truncate(MAX_FAILURE_CAUSES);
    }

    fn gather_observations(&self, out: &mut Observations) {
        let n = self.spec.num_envs;
        self.ranks.all_gather_rows(n, &mut out.images);
        self.ranks.all_gather_rows(n, &mut out.vectors);
    }

    /// Writes the rows of environments that other ranks stepped.
    fn gather_step(&mut self, out: &mut Transition) {
        let n = self.spec.num_envs;
        self.gather_observations(&mut out.observations);
        self.ranks.all_gather_rows(n, &mut out.rewards);
        let flags = [&mut out.success, &mut out.success_at_end, &mut self.truncated];
        for row in flags {
            let mut bytes: Vec<u8> = row.iter().copied().map(u8::from).collect();
            self.ranks.all_gather_rows(n, &mut bytes);
            row.iter_mut().zip(bytes).for_each(|(flag, byte)| *flag = byte != 0);
        }
        // those of running episodes have no meaning
        if self.truncated.contains(&true) {
            self.gather_observations(&mut out.final_observations);
        }
    }
}

/// Returns the factor from a return to the paper's scale, for episodes under `control`.
pub(crate) fn reward_scale(control: &ControlSettings) -> f64 {
    PERFECT_EPISODE / control.decisions_per_episode() as f64
}

impl VectorEnv for SwitchableVecEnv {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn horizon(&self) -> Option<usize> {
        Some(self.env.settings().control.decisions_per_episode())
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        let clock = Instant::now();
        let causes = failure_causes(self.env.reset(borrow(out))?);
        self.record_failures(causes);
        self.gather_observations(out);
        self.seconds += clock.elapsed().as_secs_f64();
        scale_observation_vectors(&mut out.vectors);
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        if self.stop.is_requested() {
            return Err("a stop was requested".into());
        }
        let clock = Instant::now();
        let step = self.env.step(
            actions,
            StepResultsMut {
                observations: borrow(&mut out.observations),
                final_observations: borrow(&mut out.final_observations),
                rewards: &mut out.rewards,
                success: &mut out.success,
                success_at_end: &mut out.success_at_end,
                truncated: &mut self.truncated,
            },
        );
        let causes = failure_causes(step?);
        self.record_failures(causes);
        self.gather_step(out);
        self.seconds += clock.elapsed().as_secs_f64();
        for (outcome, &truncated) in out.outcomes.iter_mut().zip(&self.truncated) {
            *outcome = if truncated { StepOutcome::Truncated } else { StepOutcome::Running };
        }
        scale_observation_vectors(&mut out.observations.vectors);
        // other rows of the final observations are old and already scaled
        scale_rows(&mut out.final_observations.vectors, &self.truncated);
        Ok(())
    }
}

fn failure_causes(failures: &[EnvFailure]) -> Vec<String> {
    failures.iter().map(|EnvFailure { env, error }| format!("environment {env}: {error}")).collect()
}

fn borrow(observations: &mut Observations) -> ObservationsMut<'_> {
    ObservationsMut { images: &mut observations.images, vectors: &mut observations.vectors }
}

/// Scales observation vectors `[N, 10]` of N environments to network inputs, in place.
pub fn scale_observation_vectors(vectors: &mut [f32]) {
    vectors.chunks_exact_mut(envs::VECTOR_OBSERVATION_DIM).for_each(scale_row);
}

fn scale_rows(vectors: &mut [f32], which: &[bool]) {
    let rows = vectors.chunks_exact_mut(envs::VECTOR_OBSERVATION_DIM).zip(which);
    rows.filter(|(_, chosen)| **chosen).for_each(|(row, _)| scale_row(row));
}

/// Scales one vector (hand x, y, z, aperture, goal x, y, z, lead x, y, z) to network inputs, in
/// place.
fn scale_row(row: &mut [f32]) {
    for (value, input) in row.iter_mut().zip(&VECTOR_INPUT_SCALING) {
        *value = (*value - input.offset) * input.factor;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hidden_goal_stays_zero_and_a_flip_stays_a_flip() {
        let mut row = [0.1, -0.05, 0.2, 0.6, 0.0, 0.0, 0.0, 0.05, 0.0, 0.0];
        scale_row(&mut row);
        assert_eq!(row, [1.0, -0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0]);
        let mut mirrored = [-0.1, -0.05, 0.2, 0.6, 0.0, 0.0, 0.0, -0.05, 0.0, 0.0];
        scale_row(&mut mirrored);
        assert_eq!([mirrored[0], mirrored[7]], [-row[0], -row[7]]);
    }
}
