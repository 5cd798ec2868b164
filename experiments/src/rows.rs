//! What a checkpoint keeps of a run's tables.

use csv::{Reader, StringRecord, Writer};
use serde::{Deserialize, Serialize};

use crate::ledger::{Served, count_served};

/// The columns of `evaluation.csv` that older versions do not write.
pub(crate) const OWN: [&str; 4] = ["own_policy", "own_success", "own_success_at_end", "own_reward"];

/// The contents of the tables, so that a run can go on where the files are lost.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Rows {
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

/// Columns of `metrics.csv` about the policy that served a group.
#[derive(Deserialize)]
struct Service {
    group: String,
    #[serde(default)]
    straddles: bool,
    policy: usize,
}

impl Rows {
    /// Counts the policies that served each group.
    pub fn served(&self) -> Result<Served, csv::Error> {
        let mut served = Served::default();
        for row in Reader::from_reader(self.metrics.as_bytes()).deserialize() {
            let Service { group, straddles, policy } = row?;
            if !straddles {
                count_served(&mut served, &group, policy);
            }
        }
        Ok(served)
    }

    /// Adds the columns of groups' own policies, empty, to scores of an older version that has none
    /// of them.
    pub fn upgrade(&mut self) -> Result<(), csv::Error> {
        let mut reader = Reader::from_reader(self.scores.as_bytes());
        let names = reader.headers()?.clone();
        if names.is_empty() || names.iter().any(|name| OWN.contains(&name)) {
            return Ok(());
        }
        let mut writer = Writer::from_writer(Vec::new());
        writer.write_record(names.iter().chain(OWN))?;
        for row in reader.records() {
            writer.write_record(row?.iter().chain([""; OWN.len()]))?;
        }
        let bytes = writer.into_inner().map_err(|error| error.into_error())?;
        self.scores = String::from_utf8_lossy(&bytes).into_owned();
        Ok(())
    }

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn policies_are_counted_in_rollouts_of_one_group() {
        let rows = Rows {
            metrics: "rollout,group,straddles,policy\n0,a,false,1\n1,a,true,0\n2,a,false,1\n\
                3,b,false,0\n"
                .to_owned(),
            ..Rows::default()
        };
        let served = rows.served().unwrap();
        assert_eq!(served["a"], [(1, 2)].into());
        assert_eq!(served["b"], [(0, 1)].into());
        assert!(Rows::default().served().unwrap().is_empty());
        let metrics = "rollout,group\n0,a\n".to_owned();
        let nameless = Rows { metrics, ..Rows::default() };
        assert!(nameless.served().is_err());
    }

    #[test]
    fn scores_of_an_older_version_get_the_new_columns_once() {
        let mut rows = Rows { scores: "rollouts,reward\n0,1.5\n".to_owned(), ..Rows::default() };
        let expected = "rollouts,reward,own_policy,own_success,own_success_at_end,own_reward\n\
            0,1.5,,,,\n";
        for _ in 0..2 {
            rows.upgrade().unwrap();
            assert_eq!(rows.scores, expected);
        }
        let mut none = Rows::default();
        none.upgrade().unwrap();
        assert!(none.scores.is_empty());
    }
}
