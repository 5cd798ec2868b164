//! What the vector environment and its worker threads hand to one another.

use std::sync::Arc;

use symmetry::D2;

use crate::batch::Batch;
use crate::error::EnvError;
use crate::scene::Scene;
use crate::settings::VecEnvSettings;
use crate::tabletop::{ACTION_DIM, Step, VECTOR_DIM};

/// What went wrong in one environment while the others went on.
#[derive(Debug)]
pub struct Failure {
    /// Index of the environment.
    pub env: usize,
    /// A diverged simulation, a panic.
    pub error: EnvError,
}

/// What a worker is asked to do; it answers each with a [`Reply`].
pub(crate) enum Command {
    /// Make a renderer for this scene, where there is none yet.
    Prepare(Arc<Scene>),
    /// Simulate this scene, which is prepared, from the next reset on, with variants drawn from
    /// these elements.
    SetTasks(Arc<Scene>, Vec<D2>),
    /// Draw what follows from the streams of this seed.
    Reseed(u64),
    /// Start an episode everywhere.
    Reset(Rows),
    /// Hold these actions for one decision.
    Step(Rows),
    /// Let this befall one row before its next decision.
    #[cfg(test)]
    Inject(usize, Fault),
}

/// Something that breaks an environment or its renderer.
#[cfg(test)]
pub(crate) type Fault = fn(&mut crate::tabletop::TableTop, &mut crate::renderer::SceneRenderer);

/// An answer: the rows that came with the command, and what ended it, if anything.
pub(crate) struct Reply {
    pub rows: Option<Rows>,
    pub result: Result<(), EnvError>,
}

/// A worker's part of a batch; sent back and forth, so that nothing is allocated per step.
pub(crate) struct Rows {
    pub actions: Vec<f32>,
    pub batch: Batch,
    pub failures: Vec<Failure>,
}

impl Rows {
    /// Rows for as many environments as `settings` say.
    pub(crate) fn new(settings: &VecEnvSettings) -> Self {
        Self {
            actions: vec![0.0; settings.num_envs * ACTION_DIM],
            batch: Batch::new(settings),
            failures: Vec::new(),
        }
    }

    /// Writes what one decision brought, and returns the images and vectors that its observation
    /// belongs in.
    pub(crate) fn write_step(&mut self, row: usize, step: &Step) -> (&mut [u8], &mut [f32]) {
        let batch = &mut self.batch;
        batch.rewards[row] = step.reward as f32;
        batch.success[row] = step.success;
        batch.success_at_end[row] = step.success_at_end;
        batch.truncated[row] = step.truncated;
        if step.truncated {
            (&mut batch.final_images, &mut batch.final_vectors)
        } else {
            (&mut batch.images, &mut batch.vectors)
        }
    }

    /// Ends the episode of `row` at its last observation, as a time-out would.
    pub(crate) fn end_early(&mut self, row: usize) {
        let batch = &mut self.batch;
        let image = batch.images.len() / batch.rewards.len();
        copy_row(&batch.images, row, &mut batch.final_images, row, image);
        let vectors = &mut batch.final_vectors;
        copy_row(&batch.vectors, row, vectors, row, VECTOR_DIM);
        batch.rewards[row] = 0.0;
        batch.success[row] = false;
        batch.success_at_end[row] = false;
        batch.truncated[row] = true;
    }
}

/// Row `row` of rows of `len` values.
pub(crate) fn row_mut<T>(values: &mut [T], row: usize, len: usize) -> &mut [T] {
    &mut values[row * len..(row + 1) * len]
}

/// Copies row `row` of `from` to row `to_row` of `to`.
pub(crate) fn copy_row<T: Copy>(from: &[T], row: usize, to: &mut [T], to_row: usize, len: usize) {
    row_mut(to, to_row, len).copy_from_slice(&from[row * len..(row + 1) * len]);
}
