//! Schema of a run's tables: one row type for each, shared by writers and readers, except that
//! `metrics.csv` is written with further columns, the metrics that learners log
//! ([`learner::Metrics`]).

use std::fmt::Display;
use std::str::FromStr;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

use crate::printable::escape_unprintable;

/// Deserialises a name with control characters escaped, so that it is safe to print.
fn name<'de, D: Deserializer<'de>>(cell: D) -> Result<String, D::Error> {
    Ok(escape_unprintable(&String::deserialize(cell)?))
}

/// Row of `metrics.csv` on one rollout, without the further metrics that learners log.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RolloutRow {
    /// Number of decisions of the run by the end of the rollout.
    pub decisions: usize,
    /// Task group at the start of the iteration.
    #[serde(deserialize_with = "name")]
    pub group: String,
    /// Task group at the end of the iteration.
    #[serde(deserialize_with = "name")]
    pub last_group: String,
    /// `true` if the task group changed within the iteration.
    #[serde(rename = "straddles")]
    pub spans_switch: bool,
    /// Index of the policy that the rollout was assigned to.
    pub policy: usize,
    /// `true` if that policy was created in this iteration.
    #[serde(default, rename = "created")]
    pub created_policy: bool,
    /// Number of rollouts that were compared before a policy was chosen, at least 1; `None` if the
    /// learner does not report it.
    #[serde(default, rename = "looks")]
    pub compared_rollouts: Option<f64>,
    /// Mean return of the episodes that ended, on the paper's scale, in `[0, 500]`; `None` if no
    /// episode ended.
    pub reward: Option<f64>,
    /// Share of ended episodes that succeeded, in `[0, 1]`; `None` if no episode ended.
    pub success: Option<f64>,
    /// For each policy, the one that it was merged into; empty if the learner merges none.
    #[serde(default, rename = "heirs", deserialize_with = "numbers")]
    pub merged_into: Vec<Option<usize>>,
    /// For each compared policy, the distance of the rollout from its reference frames; empty if
    /// the grouping measures none.
    #[serde(default, deserialize_with = "numbers")]
    pub distances: Vec<Option<f64>>,
    /// For each compared policy, the largest joint score of the random splits, which chance alone
    /// can reach.
    #[serde(default, rename = "null_maxima", deserialize_with = "numbers")]
    pub permutation_maxima: Vec<Option<f64>>,
    /// For each compared policy, the joint score of its distances over all sources.
    #[serde(default, rename = "scores", deserialize_with = "numbers")]
    pub permutation_z_scores: Vec<Option<f64>>,
}

/// Deserialises numbers separated by semicolons; empty items become `None`.
fn numbers<'de, D, N>(cell: D) -> Result<Vec<Option<N>>, D::Error>
where
    D: Deserializer<'de>,
    N: FromStr<Err: Display>,
{
    let cell = String::deserialize(cell)?;
    if cell.is_empty() {
        return Ok(Vec::new());
    }
    let number = |item: &str| match item {
        "" => Ok(None),
        item => item.parse().map(Some),
    };
    let numbers = cell.split(';').map(number).collect::<Result<_, _>>();
    numbers.map_err(|error: N::Err| D::Error::custom(format!("`{cell}`: {error}")))
}

/// Row of `evaluation.csv`: the score of one variant in one evaluation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ScoreRow {
    /// Number of rollouts trained on before the evaluation.
    pub rollouts: usize,
    /// Number of decisions taken in training before the evaluation.
    pub decisions: usize,
    /// Name of the variant's task group.
    #[serde(deserialize_with = "name")]
    pub group: String,
    /// Name of the variant's element of D2, such as `flip x`.
    #[serde(deserialize_with = "name")]
    pub element: String,
    /// `true` if training shows the variant.
    #[serde(rename = "seen")]
    pub seen_in_training: bool,
    /// Index of the policy that the learner chose; `None` if the column is missing.
    #[serde(default)]
    pub policy: Option<usize>,
    /// Number of episodes that the variant was scored on.
    pub episodes: usize,
    /// Share of episodes in which the success condition held at any step, in `[0, 1]`.
    pub success: f64,
    /// Share of episodes in which the success condition held at the last step, in `[0, 1]`.
    pub success_at_end: f64,
    /// Mean return of the episodes on the paper's scale, in `[0, 500]`.
    pub reward: f64,
    /// Index of the task group's own policy among the learner's policies
    /// ([`OwnPolicyByGroup`](crate::evaluation::OwnPolicyByGroup)). All `own_` columns are `None`
    /// if the group had none yet, and in rows of older versions.
    #[serde(default)]
    pub own_policy: Option<usize>,
    /// Share of episodes in which the group's own policy succeeded at any step, in `[0, 1]`.
    #[serde(default)]
    pub own_success: Option<f64>,
    /// Share of episodes in which the group's own policy succeeded at the last step, in `[0, 1]`.
    #[serde(default)]
    pub own_success_at_end: Option<f64>,
    /// Mean return of the group's own policy on the paper's scale, in `[0, 500]`.
    #[serde(default)]
    pub own_reward: Option<f64>,
}

impl ScoreRow {
    /// Returns `true` if the learner chose another policy than the group's own; `false` if either
    /// is not recorded.
    pub fn is_policy_mismatch(&self) -> bool {
        let both = self.policy.zip(self.own_policy);
        both.is_some_and(|(policy, own)| policy != own)
    }
}

/// Row of `units.csv`: the dormant units of one policy in one evaluation.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DormantUnitsRow {
    /// Number of rollouts trained on before the evaluation.
    pub rollouts: usize,
    /// Number of decisions taken in training before the evaluation.
    pub decisions: usize,
    /// Index of the policy whose units are counted.
    pub policy: usize,
    /// Number of rectified units of the policy's network.
    #[serde(rename = "units")]
    pub unit_count: usize,
    /// Number of dormant units of the policy's network
    /// ([`DORMANCY_THRESHOLD`](crate::evaluation::DORMANCY_THRESHOLD)).
    #[serde(rename = "dormant")]
    pub dormant_count: usize,
}

/// Row of `recognition.csv`: the count of one answer of the learner for a shown variant.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecognitionRow {
    /// Name of the group whose episodes were shown.
    #[serde(deserialize_with = "name")]
    pub group: String,
    /// Name of the shown variant's element of D2.
    #[serde(deserialize_with = "name")]
    pub element: String,
    /// Number of episodes shown each time the learner was asked.
    #[serde(rename = "episodes")]
    pub episodes_shown: usize,
    /// Index of the policy that the learner named; `None` if no policy fitted.
    pub policy: Option<usize>,
    /// Number of times that the learner gave this answer.
    #[serde(rename = "times")]
    pub count: usize,
}

/// Row of `timings.csv`: wall-clock seconds of one iteration and of its parts. Checkpoints leave
/// this table out, since clocks differ between equal runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TimingRow {
    /// Index of the rollout in the run, from 0.
    pub rollout: usize,
    /// Number of decisions of the rollout.
    #[serde(default)]
    pub decisions: usize,
    /// Wall-clock seconds of the whole training iteration.
    pub total: f64,
    /// Seconds of the environments' physics and rendering.
    pub environments: f64,
    /// Seconds in which the policy chose its actions.
    pub inference: f64,
    /// Seconds of the assignment of the rollout to a policy.
    pub assignment: f64,
    /// Wall-clock seconds of the policy update.
    pub update: f64,
}

impl TimingRow {
    /// Returns `true` if all seconds of the row are finite and not negative.
    pub fn is_valid(&self) -> bool {
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
        assert_eq!(read.merged_into, [None, Some(1)]);
        let empty = row(",").unwrap();
        assert!(empty.distances.is_empty() && empty.merged_into.is_empty());
        assert!(row("0.5;x,").is_err());
    }
}
