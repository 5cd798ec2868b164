//! What a checkpoint keeps of a run's tables.

use csv::{Reader, StringRecord};
use serde::{Deserialize, Serialize};

/// The contents of the tables, so that a run can go on where the files are lost.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Rows {
    /// Those of `metrics.csv`, a row a rollout.
    pub metrics: String,
    /// Those of `evaluation.csv`, a row a variant.
    pub scores: String,
    /// Those of `units.csv`, a row a policy; older checkpoints have none.
    #[serde(default)]
    pub units: String,
    /// Those of `recognition.csv`, a row an answer; older checkpoints have none.
    #[serde(default)]
    pub recognition: String,
}

impl Rows {
    /// The number of rollouts; none where a table is none.
    pub fn rollouts(&self) -> Option<usize> {
        count(&self.scores).and(count(&self.metrics))
    }
}

/// The number of a table's rows, without their names.
fn count(table: &str) -> Option<usize> {
    let (mut reader, mut row) = (Reader::from_reader(table.as_bytes()), StringRecord::new());
    let mut rows = 0;
    while reader.read_record(&mut row).ok()? {
        rows += 1;
    }
    Some(rows)
}
