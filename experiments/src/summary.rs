//! The figures of a whole run.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::error::RunError;
use crate::evaluation::{GroupScore, Score};

use crate::folder::{RunFolder, SUMMARY};

/// Figures of a whole run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Decisions taken while learning.
    pub decisions: usize,
    /// Wall-clock seconds of learning, without evaluations, as far as they are known.
    pub seconds: f64,
    /// Decisions per second of learning, over the rollouts whose seconds are known; none where no
    /// rollout's are.
    pub decisions_per_second: Option<f64>,
    /// Policies created.
    pub policies: usize,
    /// Those of them for whose groups others act since they were merged.
    pub merged: usize,
    /// Failures of single environments while learning, see [`crate::Stream::failures`].
    pub failures: usize,
    /// Rollouts within which the group changed; the shares below leave them out.
    pub straddled: usize,
    /// Share of rollouts assigned to the policy of their group ([`Ledger::right`](super::Ledger)),
    /// in `[0, 1]`; none where there was no rollout of one group.
    pub assignment_accuracy: Option<f64>,
    /// The same share among rollouts of groups that came back; none where none did.
    pub return_accuracy: Option<f64>,
    /// Scores of the groups after the stream.
    pub groups: Vec<GroupScore>,
    /// Scores of all their variants.
    pub variants: Vec<Score>,
    /// CRC-32 of each table of the finished run by file name, as eight hexadecimal digits. Tables
    /// that change later no longer belong to these figures.
    pub tables: BTreeMap<String, String>,
}

impl Summary {
    /// Leaves the figures in the folder of a run, which says that it is finished.
    pub(crate) fn write(&self, folder: &RunFolder) -> Result<(), RunError> {
        let text = serde_json::to_string_pretty(self);
        let text = text.map_err(|error| RunError::write(folder.path(), error))?;
        folder.replace(SUMMARY, text.as_bytes())
    }
}
