//! Copies of a run's tables in checkpoints.

use csv::{Reader, StringRecord};
use serde::{Deserialize, Serialize};

use crate::run_stats::{GroupPolicyRolloutCounts, add_rollout_count};

/// Contents of a run's tables but the timings at a checkpoint, from which lost or damaged files are
/// restored.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TableSnapshots {
    /// Text of `metrics.csv`, one row per rollout.
    pub metrics: String,
    /// Text of `evaluation.csv`, one row per variant.
    pub scores: String,
    /// Text of `units.csv`, one row per policy; empty in older checkpoints.
    #[serde(default)]
    pub units: String,
    /// Text of `recognition.csv`, one row per answer; empty in older checkpoints.
    #[serde(default)]
    pub recognition: String,
}

/// Columns of `metrics.csv` about the assignment of a rollout to a policy.
#[derive(Deserialize)]
struct AssignmentColumns {
    group: String,
    #[serde(default, rename = "straddles")]
    spans_switch: bool,
    policy: usize,
}

impl TableSnapshots {
    /// Counts the rollouts of each group by policy, without those that span a task switch.
    pub fn count_rollouts_by_group_and_policy(
        &self,
    ) -> Result<GroupPolicyRolloutCounts, csv::Error> {
        let mut served = GroupPolicyRolloutCounts::default();
        for row in Reader::from_reader(self.metrics.as_bytes()).deserialize() {
            let AssignmentColumns { group, spans_switch, policy } = row?;
            if !spans_switch {
                add_rollout_count(&mut served, &group, policy);
            }
        }
        Ok(served)
    }

    /// Returns the number of rollouts; `None` if the metrics or the scores are no valid CSV.
    pub fn rollout_count(&self) -> Option<usize> {
        count(&self.scores).and(count(&self.metrics))
    }
}

/// Counts a table's rows without the header; `None` for invalid CSV.
fn count(table: &str) -> Option<usize> {
    let (mut reader, mut row) = (Reader::from_reader(table.as_bytes()), StringRecord::new());
    let mut rows = 0;
    while reader.read_record(&mut row).ok()? {
        rows += 1;
    }
    Some(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn policies_are_counted_in_rollouts_of_one_group() {
        let rows = TableSnapshots {
            metrics: "rollout,group,straddles,policy\n0,a,false,1\n1,a,true,0\n2,a,false,1\n\
                3,b,false,0\n"
                .to_owned(),
            ..TableSnapshots::default()
        };
        let served = rows.count_rollouts_by_group_and_policy().unwrap();
        assert_eq!(served["a"], [(1, 2)].into());
        assert_eq!(served["b"], [(0, 1)].into());
        assert!(TableSnapshots::default().count_rollouts_by_group_and_policy().unwrap().is_empty());
        let metrics = "rollout,group\n0,a\n".to_owned();
        let nameless = TableSnapshots { metrics, ..TableSnapshots::default() };
        assert!(nameless.count_rollouts_by_group_and_policy().is_err());
    }
}
