//! Tables of a run: one type for the rows of each, for whoever writes or reads them.
//!
//! `metrics.csv` has further columns, those that a learner reports of itself ([`learner::Metrics`]).

use std::fmt::Display;
use std::str::FromStr;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

use crate::printable::printable;

/// A name, as it may be printed.
fn name<'de, D: Deserializer<'de>>(cell: D) -> Result<String, D::Error> {
    Ok(printable(&String::deserialize(cell)?))
}

/// A row of `metrics.csv`, without what a learner adds of its own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RolloutRow {
    /// Decisions taken by the end of the rollout.
    pub decisions: usize,
    /// The group that ran when the turn began.
    #[serde(deserialize_with = "name")]
    pub group: String,
    /// The group that ran when it ended.
    #[serde(deserialize_with = "name")]
    pub last_group: String,
    /// Whether the group changed within the turn.
    pub straddles: bool,
    /// The policy that learnt.
    pub policy: usize,
    /// Whether it was opened in this turn.
    #[serde(default)]
    pub created: bool,
    /// Rollouts that were looked at before a policy was named; none where the learner does not say.
    #[serde(default)]
    pub looks: Option<f64>,
    /// Mean return on the paper's scale, in `[0, 500]`; none where no episode ended.
    pub reward: Option<f64>,
    /// Share of episodes that succeeded, in `[0, 1]`; none where none ended.
    pub success: Option<f64>,
    /// For each policy the one that acts for its group since the two were merged; empty where the
    /// learner merges none.
    #[serde(default, deserialize_with = "numbers")]
    pub heirs: Vec<Option<usize>>,
    /// For each policy that was compared, the distance of the rollout from what it remembers; empty
    /// where the grouping measures none.
    #[serde(default, deserialize_with = "numbers")]
    pub distances: Vec<Option<f64>>,
    /// For each of them the largest distance of the permutations.
    #[serde(default, deserialize_with = "numbers")]
    pub null_maxima: Vec<Option<f64>>,
    /// For each of them how many standard deviations the distance is above that of a permutation.
    #[serde(default, deserialize_with = "numbers")]
    pub scores: Vec<Option<f64>>,
}

/// Numbers with semicolons between them, some of which are missing.
fn numbers<'de, D, N>(cell: D) -> Result<Vec<Option<N>>, D::Error>
where
    D: Deserializer<'de>,
    N: FromStr<Err: Display>,
{
    let cell = String::deserialize(cell)?;
    if cell.is_empty() {
        return Ok(Vec::new());
    }
    let number = |word: &str| match word {
        "" => Ok(None),
        word => word.parse().map(Some),
    };
    let numbers = cell.split(';').map(number).collect::<Result<_, _>>();
    numbers.map_err(|error: N::Err| D::Error::custom(format!("`{cell}`: {error}")))
}

/// A row of `evaluation.csv`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ScoreRow {
    /// Rollouts learnt from before the evaluation.
    pub rollouts: usize,
    /// Decisions taken before the evaluation.
    pub decisions: usize,
    /// The variant's group.
    #[serde(deserialize_with = "name")]
    pub group: String,
    /// The variant's element of D2, as it is spelt.
    #[serde(deserialize_with = "name")]
    pub element: String,
    /// Whether the learner meets the variant while it learns.
    pub seen: bool,
    /// Index of the policy that the learner chose; none where the row does not say.
    #[serde(default)]
    pub policy: Option<usize>,
    /// Episodes played.
    pub episodes: usize,
    /// As in [`Score`](crate::evaluation::Score).
    pub success: f64,
    /// As there.
    pub success_at_end: f64,
    /// As there.
    pub reward: f64,
    /// Index of the group's own policy ([`OwnPolicies`](crate::evaluation::OwnPolicies)); none, here
    /// and below, where the group had none yet, and in rows of older versions.
    #[serde(default)]
    pub own_policy: Option<usize>,
    /// Success of the group's own policy, in `[0, 1]`.
    #[serde(default)]
    pub own_success: Option<f64>,
    /// Success of the group's own policy at the last step, in `[0, 1]`.
    #[serde(default)]
    pub own_success_at_end: Option<f64>,
    /// Return of the group's own policy, in `[0, 500]`.
    #[serde(default)]
    pub own_reward: Option<f64>,
}

impl ScoreRow {
    /// `true` if the learner chose another policy than the group's own.
    pub fn is_mismatch(&self) -> bool {
        let both = self.policy.zip(self.own_policy);
        both.is_some_and(|(policy, own)| policy != own)
    }
}

/// A row of `units.csv`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnitsRow {
    /// Rollouts learnt from before the evaluation.
    pub rollouts: usize,
    /// Decisions taken before the evaluation.
    pub decisions: usize,
    /// The policy.
    pub policy: usize,
    /// Rectified units of its network.
    pub units: usize,
    /// Those that are dormant.
    pub dormant: usize,
}

/// A row of `recognition.csv`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecognitionRow {
    /// The group that was shown.
    #[serde(deserialize_with = "name")]
    pub group: String,
    /// The variant that was shown.
    #[serde(deserialize_with = "name")]
    pub element: String,
    /// Episodes that were shown each time.
    pub episodes: usize,
    /// The policy that was named; none where none of them was.
    pub policy: Option<usize>,
    /// How often.
    pub times: usize,
}

/// A row of `timings.csv`: seconds of one rollout and of its parts. No checkpoint holds this table,
/// since clocks differ between equal runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TimingRow {
    /// Index of the rollout, from 0.
    pub rollout: usize,
    /// Decisions of the rollout.
    #[serde(default)]
    pub decisions: usize,
    /// The whole rollout.
    pub total: f64,
    /// Physics and pictures.
    pub environments: f64,
    /// The policy's decisions.
    pub inference: f64,
    /// The grouping.
    pub assignment: f64,
    /// Gradients.
    pub update: f64,
}

impl TimingRow {
    /// Whether it can have been so.
    pub fn is_sound(&self) -> bool {
        let Self { total, environments, inference, assignment, update, .. } = *self;
        let seconds = [total, environments, inference, assignment, update];
        seconds.iter().all(|part| part.is_finite() && *part >= 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_of_several_numbers_are_read() {
        let header = "decisions,group,last_group,straddles,policy,reward,success,distances,heirs\n";
        let row = |cells: &str| -> Result<RolloutRow, csv::Error> {
            let text = format!("{header}500,a,a,false,0,,,{cells}\n");
            csv::Reader::from_reader(text.as_bytes()).deserialize().next().unwrap()
        };
        let read = row("0.5;;2,;1").unwrap();
        assert_eq!(read.distances, [Some(0.5), None, Some(2.0)]);
        assert_eq!(read.heirs, [None, Some(1)]);
        let empty = row(",").unwrap();
        assert!(empty.distances.is_empty() && empty.heirs.is_empty());
        assert!(row("0.5;x,").is_err());
    }
}
