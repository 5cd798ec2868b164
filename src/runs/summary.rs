//! The figures of a whole run.

use serde::Serialize;

use crate::evaluation::{GroupScore, Score};

/// Figures of a whole run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Decisions taken while learning.
    pub decisions: usize,
    /// Wall-clock seconds of learning, without evaluations.
    pub seconds: f64,
    /// Decisions per second of learning.
    pub decisions_per_second: f64,
    /// Policies created.
    pub policies: usize,
    /// Failures of single environments while learning, see [`crate::Stream::failures`].
    pub failures: usize,
    /// Share of rollouts assigned to the first policy that was opened for their group, in `[0, 1]`.
    pub assignment_accuracy: f64,
    /// The same share among rollouts of groups that came back.
    pub return_accuracy: f64,
    /// Scores of the groups after the stream.
    pub groups: Vec<GroupScore>,
    /// Scores of all their variants.
    pub variants: Vec<Score>,
}
