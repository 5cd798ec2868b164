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

/// What one environment does in [`VecEnv::advance`](crate::VecEnv::advance).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// Takes one decision. Where that ends the episode, the next one begins at once, as in
    /// [`VecEnv::step`](crate::VecEnv::step).
    Step,
    /// Takes one decision. Where that ends the episode, the environment waits at its last
    /// observation for a reset.
    StepAndStay,
    /// Begins an episode, whatever was going on. The action plays no part.
    Reset,
    /// Does nothing. The action plays no part.
    Rest,
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
    /// Let every row have its turn.
    Advance(Rows),
    /// Write the scripted experts' actions.
    Experts(Rows),
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
    pub turns: Vec<Turn>,
    pub actions: Vec<f32>,
    pub batch: Batch,
    pub failures: Vec<Failure>,
}

impl Rows {
    /// Rows for as many environments as `settings` say.
    pub(crate) fn new(settings: &VecEnvSettings) -> Self {
        Self {
            turns: vec![Turn::Rest; settings.num_envs],
            actions: vec![0.0; settings.num_envs * ACTION_DIM],
            batch: Batch::new(settings),
            failures: Vec::new(),
        }
    }

    /// Says of `row` that no decision was taken.
    pub(crate) fn clear(&mut self, row: usize) {
        self.write_outcome(row, &Step::default());
    }

    fn write_outcome(&mut self, row: usize, step: &Step) {
        let batch = &mut self.batch;
        batch.rewards[row] = step.reward as f32;
        batch.success[row] = step.success;
        batch.success_at_end[row] = step.success_at_end;
        batch.truncated[row] = step.truncated;
    }

    /// Whether the episode of `row` has ended and the next one begins in the same turn.
    pub(crate) fn begins_anew(&self, row: usize) -> bool {
        self.batch.truncated[row] && self.turns[row] == Turn::Step
    }

    /// Writes what one decision brought, and returns the images and vectors that its observation
    /// belongs in.
    pub(crate) fn write_step(&mut self, row: usize, step: &Step) -> (&mut [u8], &mut [f32]) {
        self.write_outcome(row, step);
        let anew = self.begins_anew(row);
        let batch = &mut self.batch;
        if anew {
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
        let truncated = true;
        self.write_outcome(row, &Step { truncated, ..Step::default() });
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
