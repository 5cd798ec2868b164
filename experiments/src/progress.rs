//! Events and summary of a run.

use std::collections::BTreeMap;

use envs::TaskGroup;
use learner::IterationReport;
use rl::RewardWarning;
use serde::Serialize;

use crate::error::RunError;
use crate::evaluation::{EvaluationResults, GroupScore, VariantScore};
use crate::folder::{RunFolder, SUMMARY_FILE};

/// Report of one training iteration: the learner's own report, the true task groups, which the
/// learner never sees, and seconds.
#[derive(Clone, Debug)]
pub struct RolloutReport {
    /// Index of the rollout in the run, from 0.
    pub rollout: usize,
    /// Number of decisions of the run so far, summed over all environments.
    pub decisions: usize,
    /// Task group that the stream showed at the start of the iteration.
    pub group: TaskGroup,
    /// Task group that the stream showed at the end of the iteration.
    pub last_group: TaskGroup,
    /// `true` if the task group changed within the iteration.
    pub spans_switch: bool,
    /// Report of the learner on the rollout.
    pub iteration: IterationReport,
    /// Warning about rewards that are too large or too small to train on; each kind is given once
    /// after each start or resumption.
    pub warning: Option<RewardWarning>,
    /// Causes of the first failures of environments in the rollout. The episode of a failed
    /// environment counts as one that ended there.
    pub environment_failures: Vec<String>,
    /// Factor from a return to the paper's scale, on which a perfect episode earns 500.
    pub reward_scale: f64,
    /// Wall-clock seconds of the iteration, without evaluations.
    pub seconds: f64,
    /// Wall-clock seconds of the environments (physics and rendering), part of `seconds`.
    pub environment_seconds: f64,
}

impl RolloutReport {
    /// Returns the mean return of the episodes that ended in the rollout, on the paper's scale, in
    /// `[0, 500]`; `None` if no episode ended.
    pub fn scaled_mean_return(&self) -> Option<f64> {
        let mean_return = self.iteration.rollout_stats.mean_return()?;
        Some(mean_return * self.reward_scale)
    }

    /// Returns the share of the rollout's ended episodes that succeeded at any step, in `[0, 1]`;
    /// `None` if no episode ended.
    pub fn success_rate(&self) -> Option<f64> {
        self.iteration.rollout_stats.success_rate()
    }
}

/// Report of one evaluation of a run.
#[derive(Clone, Debug)]
pub struct EvaluationReport {
    /// Number of rollouts trained on before the evaluation; 0 before the stream.
    pub rollouts: usize,
    /// Number of decisions taken in training before the evaluation.
    pub decisions: usize,
    /// Results of the evaluation: scores and recognitions. Recognition is tested only after the
    /// stream.
    pub results: EvaluationResults,
}

/// Event of a run: a rollout or an evaluation.
#[derive(Clone, Debug)]
pub enum RunEvent {
    /// Training iteration of the learner with one rollout.
    Rollout(Box<RolloutReport>),
    /// Evaluation of the learner on all task variants.
    Evaluation(EvaluationReport),
}

/// Returns the warning about a failure of an environment with this cause.
pub fn environment_failure_warning(cause: &str) -> String {
    format!("{cause}; its episode counts as one that ended there")
}

impl RunEvent {
    /// Returns the warnings that the event gives rise to: about rewards that are hard to train on,
    /// and about environments that failed.
    pub fn warnings(&self) -> Vec<String> {
        let (rewards, causes) = match self {
            Self::Rollout(rollout) => (rollout.warning, &rollout.environment_failures),
            Self::Evaluation(evaluation) => (None, &evaluation.results.environment_failures),
        };
        let of_rewards = rewards.into_iter().map(|warning| warning.to_string());
        let failures = causes.iter().map(|cause| environment_failure_warning(cause));
        of_rewards.chain(failures).collect()
    }
}

/// Summary of a whole run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunSummary {
    /// Number of decisions taken in training.
    pub decisions: usize,
    /// Wall-clock seconds of training, without evaluations, as far as they are known.
    pub seconds: f64,
    /// Decisions per second of training, over the rollouts with known seconds; `None` without any.
    pub decisions_per_second: Option<f64>,
    /// Number of policies that the learner created.
    pub policies: usize,
    /// Number of policies that were merged into others.
    #[serde(rename = "merged")]
    pub merged_policies: usize,
    /// Failures of single environments in training, see
    /// [`crate::SwitchableVecEnv::environment_failures`].
    #[serde(rename = "failures")]
    pub environment_failures: usize,
    /// Number of rollouts that span a task switch; both accuracies leave them out.
    #[serde(rename = "straddled")]
    pub switch_rollouts: usize,
    /// Share of rollouts assigned to the policy of their group, in `[0, 1]`
    /// ([`RunStats::correct_assignments`](crate::RunStats::correct_assignments)); `None` if all
    /// rollouts span a task switch.
    pub assignment_accuracy: Option<f64>,
    /// Assignment accuracy over rollouts of groups that were visited before; `None` without any.
    #[serde(rename = "return_accuracy")]
    pub revisit_accuracy: Option<f64>,
    /// Scores of each task group in the last evaluation.
    pub groups: Vec<GroupScore>,
    /// Scores of each task variant in the last evaluation.
    pub variants: Vec<VariantScore>,
    /// CRC-32 of each table of the finished run by file name, as eight hexadecimal digits. It
    /// detects tables that were changed later.
    #[serde(rename = "tables")]
    pub table_checksums: BTreeMap<String, String>,
}

impl RunSummary {
    /// Writes the summary to the folder of a run, which marks the run as finished.
    pub(crate) fn write(&self, folder: &RunFolder) -> Result<(), RunError> {
        let text = serde_json::to_string_pretty(self)
            .map_err(RunError::write_error_mapper(folder.path()))?;
        folder.replace_file(SUMMARY_FILE, text.as_bytes())
    }
}
