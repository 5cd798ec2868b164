//! Messages between the vector environment and its worker threads.

use std::sync::Arc;

use rand_chacha::ChaCha8Rng;
use symmetry::D2;

use crate::arm_occlusion::ArmOcclusion;
use crate::batch::StepBuffers;
use crate::camera::Camera;
use crate::domain_randomiser::CameraErrors;
use crate::error::EnvError;
use crate::randomisation::VisualDomainRandomisation;
use crate::renderer::ViewSettings;
use crate::scene::Scene;
use crate::settings::VecEnvSettings;
use crate::tabletop::{
    ACTION_DIM, STATE_DETAILS_DIM, StepResult, TableTopSnapshot, VECTOR_OBSERVATION_DIM,
};

/// Failure of one environment, which does not affect the others.
#[derive(Debug)]
pub struct EnvFailure {
    /// Index of the environment that failed.
    pub env: usize,
    /// Error of the environment: a diverged simulation, a panic, or a decision without an episode.
    pub error: EnvError,
}

/// Command for one environment in [`VecEnv::execute_commands`](crate::VecEnv::execute_commands).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EnvCommand {
    /// Command to take one decision. If it ends the episode, the next one begins at once, as in
    /// [`VecEnv::step`](crate::VecEnv::step) (Gymnasium's same-step autoreset).
    Step,
    /// Command to take one decision. If it ends the episode, the environment keeps its last
    /// observation until a reset.
    StepNoAutoReset,
    /// Command to begin an episode, and to abandon a running one. The action is ignored.
    Reset,
    /// Command to do nothing: the environment keeps its last observation. The action is ignored.
    Idle,
}

/// Command for a worker thread, which answers each command with a [`WorkerReply`].
pub(crate) enum WorkerCommand {
    /// Command to make a renderer for a scene, unless there is one.
    Prepare(Arc<Scene>),
    /// Command to use a prepared scene from the next reset on, with variants drawn from the given
    /// elements of D2.
    SetTasks(Arc<Scene>, Vec<D2>),
    /// Command to restart the random streams, with seed and stream of every environment of the
    /// vector.
    Reseed(Arc<[(u64, usize)]>),
    /// Command to execute the [`EnvCommand`] of every environment of the worker.
    Advance(WorkerBatch),
    /// Command to write the scripted experts' actions for the present states.
    Experts(WorkerBatch),
    /// Command to write the positions and reward terms of the present states, see
    /// [`STATE_DETAILS_DIM`].
    Details(WorkerBatch),
    /// Command to render the present states in the batch's view.
    Render(WorkerBatch),
    /// Command to write snapshots of the running episodes.
    Save(WorkerBatch),
    /// Command to restore the episodes of the snapshots.
    Restore(WorkerBatch),
    /// Command to apply a fault to one environment before its next decision.
    #[cfg(test)]
    Inject(usize, Fault),
}

/// Function that breaks an environment or its renderer, for tests of failures.
#[cfg(test)]
pub(crate) type Fault = fn(&mut crate::tabletop::TableTop, &mut crate::renderer::SceneRenderer);

/// Answer of a worker thread: the buffers that came with the command, and an error that stopped it.
pub(crate) struct WorkerReply {
    pub rows: Option<WorkerBatch>,
    pub result: Result<(), EnvError>,
}

/// State of one environment of a [`VecEnv`](crate::VecEnv) in the middle of an episode, with its
/// random streams and last observation.
#[derive(Clone, Debug)]
pub struct EnvSnapshot {
    pub(crate) table: TableTopSnapshot,
    pub(crate) rng: ChaCha8Rng,
    pub(crate) camera_state: CameraErrors,
    pub(crate) first: Vec<u8>,
    pub(crate) occlusion: ArmOcclusion,
    pub(crate) image: Vec<u8>,
    pub(crate) vector: Vec<f32>,
    /// Settings by which the pictures were drawn.
    pub(crate) pictures: PictureSettings,
}

/// Settings of a vector of environments that determine its pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PictureSettings {
    pub camera: Camera,
    pub randomisation: Option<VisualDomainRandomisation>,
}

impl PictureSettings {
    pub(crate) fn new(settings: &VecEnvSettings) -> Self {
        Self { camera: settings.camera, randomisation: settings.randomisation }
    }
}

/// Buffers of the environments of one worker thread, one row each; sent back and forth, so that a
/// step allocates nothing.
pub(crate) struct WorkerBatch {
    pub commands: Vec<EnvCommand>,
    pub actions: Vec<f32>,
    pub batch: StepBuffers,
    /// Positions and reward terms of the states, `[N, 16]`, see [`STATE_DETAILS_DIM`].
    pub details: Vec<f32>,
    /// View to render, and its pictures `[N, size, size, 3]`; `None` but for a render command.
    pub view: Option<(ViewSettings, Vec<u8>)>,
    /// Snapshots on their way to or from [`VecEnv`](crate::VecEnv); empty otherwise.
    pub snapshots: Vec<EnvSnapshot>,
    pub failures: Vec<EnvFailure>,
}

impl WorkerBatch {
    /// Creates buffers for `settings.num_envs` environments.
    pub(crate) fn new(settings: &VecEnvSettings) -> Self {
        Self {
            commands: vec![EnvCommand::Idle; settings.num_envs],
            actions: vec![0.0; settings.num_envs * ACTION_DIM],
            batch: StepBuffers::new(settings),
            details: vec![0.0; settings.num_envs * STATE_DETAILS_DIM],
            view: None,
            snapshots: Vec::new(),
            failures: Vec::new(),
        }
    }

    /// Clears the outcome of environment `row`, which took no decision.
    pub(crate) fn clear(&mut self, row: usize) {
        self.write_outcome(row, &StepResult::default());
    }

    fn write_outcome(&mut self, row: usize, step: &StepResult) {
        let batch = &mut self.batch;
        batch.rewards[row] = step.reward as f32;
        batch.success[row] = step.success;
        batch.success_at_end[row] = step.success_at_end;
        batch.truncated[row] = step.truncated;
    }

    /// Returns `true` if the episode of environment `row` has ended and its command begins the next
    /// one.
    pub(crate) fn auto_resets(&self, row: usize) -> bool {
        self.batch.truncated[row] && self.commands[row] == EnvCommand::Step
    }

    /// Writes the outcome of a decision, and returns the images and vectors for its observation:
    /// the final ones if the next episode begins at once.
    pub(crate) fn write_step(&mut self, row: usize, step: &StepResult) -> (&mut [u8], &mut [f32]) {
        self.write_outcome(row, step);
        let anew = self.auto_resets(row);
        let batch = &mut self.batch;
        if anew {
            (&mut batch.final_images, &mut batch.final_vectors)
        } else {
            (&mut batch.images, &mut batch.vectors)
        }
    }

    /// Ends the episode of environment `row` at its last observation, like a time-out.
    pub(crate) fn end_as_truncated(&mut self, row: usize) {
        let batch = &mut self.batch;
        let image = batch.images.len() / batch.rewards.len();
        copy_row(&batch.images, row, &mut batch.final_images, row, image);
        let vectors = &mut batch.final_vectors;
        copy_row(&batch.vectors, row, vectors, row, VECTOR_OBSERVATION_DIM);
        let truncated = true;
        self.write_outcome(row, &StepResult { truncated, ..StepResult::default() });
    }
}

/// Returns row `row` of a flat array with rows of `len` values.
pub(crate) fn row_mut<T>(values: &mut [T], row: usize, len: usize) -> &mut [T] {
    &mut values[row * len..(row + 1) * len]
}

/// Copies row `row` of the flat array `from` to row `to_row` of `to`.
pub(crate) fn copy_row<T: Copy>(from: &[T], row: usize, to: &mut [T], to_row: usize, len: usize) {
    row_mut(to, to_row, len).copy_from_slice(&from[row * len..(row + 1) * len]);
}
