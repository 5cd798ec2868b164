//! State of a run that its checkpoints hold beside the learner, as their note.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::RunError;
use crate::experiment::Experiment;
use crate::schedule::MAX_STREAM_DECISIONS;
use learner::read_checkpoint_note;

use crate::checkpoints::rollouts_in_name;
use crate::rows::TableSnapshots;
use crate::run_stats::RunStats;

/// Upper bound on the decisions of a run in a valid checkpoint. Learners discard some rollouts, so
/// a run may take more decisions than its stream has, but never a thousand times as many.
const TOO_MANY: usize = 1000 * MAX_STREAM_DECISIONS;

/// Progress of a run: statistics, the next evaluation and the tables so far.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RunState {
    #[serde(rename = "ledger")]
    pub stats: RunStats,
    /// Episodes in each environment of an evaluation that is due before the next rollout; 0 for
    /// none.
    #[serde(rename = "due")]
    pub due_episodes_per_env: usize,
    #[serde(rename = "rows")]
    pub tables: TableSnapshots,
}

/// State of a run with the run's settings, as checkpoints hold both.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SavedRun {
    pub experiment: Experiment,
    #[serde(rename = "note")]
    pub state: RunState,
}

impl RunState {
    /// Serialises the run's state and its settings `experiment`, but for the number of threads, as
    /// JSON, the note of a checkpoint.
    pub fn into_checkpoint_json(
        self,
        experiment: &Experiment,
    ) -> Result<String, serde_json::Error> {
        serde_json::to_string(&SavedRun {
            // results do not depend on threads, so checkpoints must not either
            experiment: experiment.clone().with_threads(1),
            state: self,
        })
    }
}

impl SavedRun {
    /// Reads a run's settings and state from the checkpoint at `path`.
    ///
    /// # Errors
    /// [`RunError::Read`], [`learner::LearnerError::NewerFormat`].
    pub fn read(path: &Path) -> Result<Self, RunError> {
        Self::parse(path, &read_checkpoint_note(path)?)
    }

    /// Parses and checks `note`, the settings and state of a run as JSON from the checkpoint at
    /// `path`. Reads no file, but a number of rollouts in the name of `path` must agree.
    ///
    /// # Errors
    /// [`RunError::Read`], also for counts and rows that no run has, and for a checkpoint whose
    /// name states another number of rollouts.
    pub fn parse(path: &Path, note: &str) -> Result<Self, RunError> {
        let saved: Self = serde_json::from_str(note).map_err(RunError::read_error_mapper(path))?;
        let wrong = |what: &str| RunError::damaged_file(path, format!("the run's note: {what}"));
        saved.check().map_err(wrong)?;
        let rollouts = saved.state.stats.rollouts;
        match rollouts_in_name(path) {
            // with a higher number it would be taken for the newest one for ever
            Some(named) if named != rollouts => Err(RunError::damaged_file(
                path,
                format!(
                    "it is the checkpoint after {rollouts} rollouts under the name of the one \
                     after {named}"
                ),
            )),
            _ => Ok(saved),
        }
    }

    /// Recomputes the rollout counts by group and policy, which checkpoints leave out, from the
    /// saved tables.
    ///
    /// # Errors
    /// [`RunError::Read`] for rows without group or policy.
    pub fn recount_rollouts(&mut self, path: &Path) -> Result<(), RunError> {
        let RunState { stats, tables, .. } = &mut self.state;
        let wrong = |error| RunError::damaged_file(path, format!("the rows of the run: {error}"));
        stats.count_rollouts_by_group_and_policy =
            tables.count_rollouts_by_group_and_policy().map_err(wrong)?;
        Ok(())
    }

    fn check(&self) -> Result<(), &'static str> {
        let (RunState { stats, due_episodes_per_env: due, tables }, plan) =
            (&self.state, &self.experiment.evaluation);
        if !stats.is_consistent() || stats.decisions > TOO_MANY {
            return Err("its counts do not add up");
        }
        if ![0, plan.episodes_per_env, plan.visit_episodes_per_env].contains(due) {
            return Err("the evaluation that is due does not fit its settings");
        }
        if tables.rollout_count() != Some(stats.rollouts) {
            return Err("its number of rows differs from its number of rollouts");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::presets::{Budget, Method};

    fn tables(metrics: &str) -> TableSnapshots {
        TableSnapshots {
            metrics: metrics.to_owned(),
            scores: "rollouts\n0\n0\n".to_owned(),
            ..TableSnapshots::default()
        }
    }

    fn note(change: impl FnOnce(&mut RunState)) -> Result<SavedRun, RunError> {
        let mut state = RunState {
            stats: RunStats {
                rollouts: 2,
                decisions: 160,
                correct_assignments: 2,
                ..RunStats::default()
            },
            due_episodes_per_env: 0,
            tables: tables("rollout,group\n0,a\n1,\"b\nc\"\n"),
        };
        change(&mut state);
        let text = state.into_checkpoint_json(&Budget::Smoke.preset_experiment(Method::Covers));
        SavedRun::parse(Path::new("file"), &text.unwrap())
    }

    #[test]
    fn a_note_comes_back() {
        let SavedRun { state, .. } = note(|_| {}).unwrap();
        assert_eq!((state.stats.rollouts, state.due_episodes_per_env), (2, 0));
        assert!(note(|note| note.due_episodes_per_env = 1).is_ok());
    }

    #[test]
    fn notes_that_no_run_writes_are_refused() {
        type Spoil = fn(&mut RunState);
        let cases: [(Spoil, &str); 6] = [
            (|note| note.stats.switch_rollouts = 1, "do not add up"),
            (|note| note.stats.correct_revisits = 1, "do not add up"),
            (|note| note.stats.rollouts = usize::MAX, "do not add up"),
            (|note| note.stats.decisions = usize::MAX, "do not add up"),
            (|note| note.due_episodes_per_env = 7, "evaluation"),
            (|note| note.tables = tables("rollout\n0\n"), "rows"),
        ];
        for (change, expected) in cases {
            let message = note(change).err().unwrap().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
