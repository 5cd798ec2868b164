//! Trait of all learners, with the reports of their iterations and evaluations.

use std::fmt;
use std::path::Path;

use cluster::{PermutationTestResult, PolicyEvidence};
use rand_chacha::ChaCha8Rng;
use rl::{ExportedPolicy, Observations, PolicyOutput, RolloutStats, UnitActivity, VectorEnv};

use crate::disk::{LocalDisk, write_atomically};
use crate::error::LearnerError;
use crate::groupings::RecognisedPolicy;

/// Continual learner: trains policies on a stream of tasks. No method takes a task's label.
pub trait Learner: Send {
    /// Runs one training iteration: collects experience in `env`, whose episodes begin anew, and
    /// trains a policy on it.
    ///
    /// # Errors
    /// Errors of the environment, a policy or a grouping.
    fn learn(&mut self, env: &mut dyn VectorEnv) -> Result<IterationReport, LearnerError>;

    /// Returns the policy that fits the tasks of `env`, judged by new episodes: exactly `episodes`,
    /// or for `None` as many as the learner needs. Nothing is trained.
    ///
    /// All random numbers come from `rng`, so that recognition does not change what is learnt next.
    ///
    /// # Errors
    /// Errors of the environment, a policy or a grouping.
    fn recognise_policy(
        &mut self,
        env: &mut dyn VectorEnv,
        episodes: Option<usize>,
        rng: &mut ChaCha8Rng,
    ) -> Result<RecognisedPolicy, LearnerError>;

    /// Evaluates policy `index` with its mean actions, in `rounds` episodes of every environment.
    ///
    /// # Errors
    /// [`LearnerError::InvalidSetting`] for a policy that does not exist, or an error of the
    /// environment.
    fn evaluate_policy(
        &mut self,
        index: usize,
        env: &mut dyn VectorEnv,
        rounds: usize,
    ) -> Result<PolicyEvaluationResult, LearnerError>;

    /// Returns all parameters of policy `index` that [`Learner::evaluate_policy`] depends on, so
    /// that a policy whose parameters have not changed need not be evaluated again. The default is
    /// `None`.
    fn policy_parameters(&self, _index: usize) -> Option<&[f32]> {
        None
    }

    /// Returns policy `index` as ordinary neural-network layers.
    ///
    /// # Errors
    /// [`LearnerError::InvalidSetting`] for a policy that does not exist,
    /// [`rl::RlError::NotExportable`] for one that other programs have no layers for,
    /// [`LearnerError::Unexportable`] for learners that write none.
    fn export_policy(&self, _index: usize) -> Result<ExportedPolicy, LearnerError> {
        Err(LearnerError::Unexportable)
    }

    /// Returns the output of policy `index` for `observations`, its mean actions among it.
    ///
    /// # Errors
    /// [`LearnerError::InvalidSetting`] for a policy that does not exist, errors of
    /// [`rl::ExportPolicy::reference_output`], and [`LearnerError::Unexportable`] for learners
    /// that return none.
    fn policy_output(
        &mut self,
        _index: usize,
        _observations: &Observations,
    ) -> Result<PolicyOutput, LearnerError> {
        Err(LearnerError::Unexportable)
    }

    /// Returns the number of policies that the learner holds, at least 1.
    fn policy_count(&self) -> usize;

    /// Returns the bytes of a checkpoint that holds the learner and a note of the caller's; equal
    /// learners give equal bytes. `path` is where they will be written, for errors to name.
    ///
    /// # Errors
    /// [`LearnerError::NotFinite`] for a learner with a number that is not finite;
    /// [`LearnerError::InvalidSetting`] for an extent of too few episodes.
    fn to_checkpoint_bytes(
        &self,
        path: &Path,
        extent: CheckpointExtent,
        note: &str,
    ) -> Result<Vec<u8>, LearnerError>;

    /// Writes a checkpoint that holds the learner and a note of the caller's to the file at `path`.
    /// The file appears whole or not at all, also after a power cut;
    /// [`LearnerSettings::load_for_acting`](super::LearnerSettings::load_for_acting) reads it.
    ///
    /// # Errors
    /// Errors of [`to_checkpoint_bytes`](Learner::to_checkpoint_bytes), and
    /// [`LearnerError::Write`].
    fn save(&self, path: &Path, extent: CheckpointExtent, note: &str) -> Result<(), LearnerError> {
        write_atomically(&LocalDisk, path, &self.to_checkpoint_bytes(path, extent, note)?)
    }
}

/// Result of an evaluation of a policy ([`Learner::evaluate_policy`]).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PolicyEvaluationResult {
    /// Returns and successes of the episodes.
    pub stats: RolloutStats,
    /// Activity of the units of the policy's network during the episodes; empty for a learner
    /// without such units.
    pub activity: UnitActivity,
}

/// Report of one training iteration of a learner ([`Learner::learn`]).
#[derive(Clone, Debug, Default)]
pub struct IterationReport {
    /// Index of the policy that trained.
    pub policy: usize,
    /// `true` if the policy that trained was created in this iteration.
    pub policy_created: bool,
    /// Evidence for and against each policy that the grouping compared; empty for learners and
    /// groupings that compare nothing.
    pub evidence: Vec<PolicyEvidence>,
    /// Number of rollouts and trials on which no policy trained, since the grouping left them
    /// undecided or the task group changed.
    pub discarded: usize,
    /// For each policy, the index of the policy that it was merged into, if any; empty for learners
    /// and groupings that merge no policies.
    pub merged_into: Vec<Option<usize>>,
    /// Number of decisions taken in the iteration in all environments, those of discarded rollouts
    /// included.
    pub decisions: usize,
    /// Returns and successes of the rollout that was trained on.
    pub rollout_stats: RolloutStats,
    /// Values that the learner logs for the iteration, by name; the same names in every iteration.
    pub metrics: Metrics,
    /// Wall-clock seconds that each part of the iteration took.
    pub seconds: IterationSeconds,
}

/// Wall-clock seconds of the parts of an iteration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct IterationSeconds {
    /// Seconds of the collection of rollouts: the environments and the policy's decisions.
    pub collection: f64,
    /// Seconds of the assignment of rollouts to policies: features, distances and permutations.
    pub assignment: f64,
    /// Seconds of the policy update.
    pub update: f64,
}

/// Part of a learner that a checkpoint holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CheckpointExtent {
    /// All of the learner: a copy that is trained further gets bit-identical parameters.
    Everything,
    /// Enough of the learner to act and to recognise task groups: policies, and the first frames of
    /// some episodes each. A copy that is trained further starts with fresh optimisers.
    Policies {
        /// Largest number of episodes whose first frames are kept for each policy; at least as many
        /// as the grouping needs to recognise a task group.
        episodes_per_policy: usize,
    },
}

/// Value that a learner logs: one number, or one for each policy.
#[derive(Clone, Debug, PartialEq)]
pub enum MetricValue {
    /// Single number for the whole learner.
    Number(f64),
    /// One number for each policy, in the order of the policies; `None` if there was nothing to
    /// measure.
    PerPolicy(Vec<Option<f64>>),
}

impl fmt::Display for MetricValue {
    /// Writes the cell of a table: the shortest decimal that reads back to the same bits; numbers
    /// of several policies are joined by semicolons, and one that was not measured is empty.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(value) => write!(f, "{value}"),
            Self::PerPolicy(values) => {
                let cell = |value: &Option<f64>| value.map_or_else(String::new, |v| v.to_string());
                let cells: Vec<String> = values.iter().map(cell).collect();
                f.write_str(&cells.join(";"))
            }
        }
    }
}

/// Logged values by name, in the order in which they are logged.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Metrics(Vec<(String, MetricValue)>);

impl Metrics {
    /// Adds one number for the whole learner to the logged values, under a name.
    pub fn add_number(&mut self, name: impl Into<String>, value: f64) {
        self.0.push((name.into(), MetricValue::Number(value)));
    }

    /// Adds a list with one number for each policy to the logged values, under a name.
    pub fn add_per_policy(
        &mut self,
        name: impl Into<String>,
        values: impl IntoIterator<Item = Option<f64>>,
    ) {
        let values = MetricValue::PerPolicy(values.into_iter().collect());
        self.0.push((name.into(), values));
    }

    /// Returns the value that was logged under a name; `None` if there is none.
    pub fn metric(&self, name: &str) -> Option<&MetricValue> {
        self.iter().find(|(own, _)| *own == name).map(|(_, m)| m)
    }

    /// Returns an iterator over names and values, in the order in which they are logged.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &MetricValue)> {
        self.0.iter().map(|(name, value)| (name.as_str(), value))
    }
}

const DISTANCES: &str = "distances";
const MERGED_INTO: &str = "heirs";

/// Name of a log column with one number for each policy, and the function that reads the number
/// from a permutation test.
type TestColumn = (&'static str, fn(&PermutationTestResult) -> f64);

const TEST_COLUMNS: [TestColumn; 5] = [
    ("null_means", |test| test.null.mean),
    ("null_maxima", |test| test.null.max),
    ("scores", |test| test.score),
    ("p_values", |test| test.p_value),
    ("tail_p_values", |test| test.tail_p_value),
];

/// Returns the names of the log columns that list one number for each policy, even while there is
/// only one policy.
pub fn per_policy_metric_names() -> impl Iterator<Item = &'static str> {
    let tests = TEST_COLUMNS.into_iter().map(|(name, _)| name);
    [DISTANCES, MERGED_INTO].into_iter().chain(tests)
}

/// Largest number of rollouts and trials of an iteration on which no policy trains.
// Groups that all change at once need one each. The bound prevents an endless iteration.
const MAX_DISCARDED: usize = 16;

impl IterationReport {
    /// Returns `true` if the iteration may leave one more rollout undecided and discard it.
    pub(super) fn may_discard(&self) -> bool {
        self.discarded < MAX_DISCARDED
    }

    /// Logs the evidence of the grouping, the merged policies if any, and the values `update` of
    /// the training.
    pub(super) fn log_metrics(&mut self, update: Vec<(String, f64)>) {
        let (metrics, evidence) = (&mut self.metrics, &self.evidence);
        metrics.add_number("looks", (1 + self.discarded) as f64);
        metrics.add_per_policy(DISTANCES, evidence.iter().map(|e| Some(e.distance)));
        for (name, number) in TEST_COLUMNS {
            metrics.add_per_policy(name, evidence.iter().map(|e| e.test.as_ref().map(number)));
        }
        if !self.merged_into.is_empty() {
            let merged = self.merged_into.iter();
            metrics.add_per_policy(MERGED_INTO, merged.map(|into| into.map(|index| index as f64)));
        }
        for (name, value) in update {
            metrics.add_number(name, value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_read_back_to_the_same_bits_and_gaps_are_empty() {
        let mut metrics = Metrics::default();
        metrics.add_number("loss", 0.1 + 0.2);
        metrics.add_per_policy("distances", [Some(1.5), None, Some(-2.0)]);
        let loss = metrics.metric("loss").unwrap().to_string();
        assert_eq!(loss.parse::<f64>().unwrap(), 0.1 + 0.2);
        assert_eq!(metrics.metric("distances").unwrap().to_string(), "1.5;;-2");
        assert_eq!(metrics.metric("lost"), None);
        let names: Vec<&str> = metrics.iter().map(|(name, _)| name).collect();
        assert_eq!(names, ["loss", "distances"]);
    }
}
