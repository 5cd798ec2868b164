//! A rollout whose end belongs to somebody else.

use super::RolloutBuffer;
use crate::error::RlError;

impl RolloutBuffer {
    /// Forgets all steps but the first `steps`, until [`RolloutBuffer::clear`]. Episodes that still
    /// run there bootstrap from the values of the step that follows.
    ///
    /// # Errors
    /// [`RlError::BufferNotFinished`] before `finish`, [`RlError::Setting`] for no step at all.
    pub fn truncate(&mut self, steps: usize) -> Result<(), RlError> {
        self.check_finished()?;
        if steps == 0 {
            return Err(RlError::Setting {
                name: "steps",
                value: 0.0,
                expected: "at least 1",
            });
        }
        if steps >= self.steps {
            return Ok(());
        }
        let n = self.spec.num_envs;
        let (from, to) = (steps * n, (steps + 1) * n);
        let (image, vector) = (self.spec.image_len(), self.spec.vector.len());
        let next = &self.observations;
        self.last
            .images
            .copy_from_slice(&next.images[from * image..to * image]);
        self.last
            .vectors
            .copy_from_slice(&next.vectors[from * vector..to * vector]);
        self.last_values
            .copy_from_slice(&self.decisions.values[from..to]);
        let ends = self.truncated.partition_point(|&sample| sample < from);
        self.truncated.truncate(ends);
        self.finals.images.truncate(ends * image);
        self.finals.vectors.truncate(ends * vector);
        self.resize(steps);
        self.pushed = steps;
        Ok(())
    }

    /// Makes room for so many steps; those that are there stay.
    pub(super) fn resize(&mut self, steps: usize) {
        let (spec, samples) = (&self.spec, steps * self.spec.num_envs);
        self.observations
            .images
            .resize(samples * spec.image_len(), 0);
        self.observations
            .vectors
            .resize(samples * spec.vector.len(), 0.0);
        self.decisions
            .actions
            .resize(samples * spec.action.len(), 0.0);
        self.decisions.log_probs.resize(samples, 0.0);
        self.decisions.values.resize(samples, 0.0);
        self.rewards.resize(samples, 0.0);
        self.outcomes.resize(samples, crate::env::Outcome::Running);
        self.final_values.resize(samples, 0.0);
        self.steps = steps;
    }
}
