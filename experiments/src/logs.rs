//! CSV files of a run. All but `timings.csv` hold no clock time, so equal runs give equal bytes.

use std::collections::BTreeMap;

use crate::error::RunError;
use crate::evaluation::VariantScore;

use crate::folder::{RunFolder, SAVED_TIMINGS_FILE, TIMINGS_FILE};
use crate::progress::{EvaluationReport, RolloutReport};
use crate::provenance::crc32_hex;
use crate::rows::TableSnapshots;
use crate::schema::{ScoreRow, TimingRow};
use crate::table::CsvFile;
use crate::timings::{TimingSums, first_timing_rows};

/// CSV tables of a run in progress. Rows are written before the next rollout starts.
pub(crate) struct RunTables {
    metrics: CsvFile,
    scores: CsvFile,
    units: CsvFile,
    recognition: CsvFile,
    timings: CsvFile,
}

impl RunTables {
    /// Opens a run's tables and restores their contents as they were after `rollouts` rollouts,
    /// from `snapshots` and, for the timings, from their files.
    pub fn open(
        folder: &RunFolder,
        rollouts: usize,
        snapshots: TableSnapshots,
    ) -> Result<Self, RunError> {
        let open = |name: &str, text: String| {
            CsvFile::open(folder.file_path(name), folder.shared_disk(), text.into_bytes())
        };
        let read = |name| std::fs::read(folder.file_path(name)).unwrap_or_default();
        let (mut timings, saved) = (read(TIMINGS_FILE), read(SAVED_TIMINGS_FILE));
        // rows behind the copy are later rollouts of the run; anything else was lost or edited
        if !timings.starts_with(&saved) {
            timings = saved;
        }
        Ok(Self {
            metrics: open("metrics.csv", snapshots.metrics)?,
            scores: open("evaluation.csv", snapshots.scores)?,
            units: open("units.csv", snapshots.units)?,
            recognition: open("recognition.csv", snapshots.recognition)?,
            timings: open(TIMINGS_FILE, first_timing_rows(&timings, rollouts))?,
        })
    }

    /// Returns the contents of the run's tables but the timings, for a checkpoint.
    pub fn snapshot(&self) -> TableSnapshots {
        let text = |table: &CsvFile| String::from_utf8_lossy(table.text()).into_owned();
        TableSnapshots {
            metrics: text(&self.metrics),
            scores: text(&self.scores),
            units: text(&self.units),
            recognition: text(&self.recognition),
        }
    }

    /// Returns the sums of seconds and decisions over the rollouts so far whose wall-clock seconds
    /// are known.
    pub fn timing_sums(&self) -> TimingSums {
        TimingSums::of_table(self.timings_csv())
    }

    /// Returns the contents of `timings.csv`.
    pub fn timings_csv(&self) -> &[u8] {
        self.timings.text()
    }

    /// Syncs all tables to the disk.
    pub fn sync(&self) -> Result<(), RunError> {
        self.tables().into_iter().try_for_each(CsvFile::sync)
    }

    /// Returns the CRC-32 of each table by file name, as eight hexadecimal digits.
    pub fn checksums(&self) -> BTreeMap<String, String> {
        let sum = |table: &CsvFile| (table.name(), crc32_hex(table.text()));
        self.tables().map(sum).into_iter().collect()
    }

    fn tables(&self) -> [&CsvFile; 5] {
        [&self.metrics, &self.scores, &self.units, &self.recognition, &self.timings]
    }

    /// Appends the rows of one rollout to `metrics.csv` and `timings.csv`.
    pub fn write_rollout(&mut self, progress: &RolloutReport) -> Result<(), RunError> {
        self.metrics.append_row(row(progress))?;
        self.timings.append_rows([timing_row(progress)])
    }

    /// Appends one evaluation's rows to the tables of scores, dormant units and recognition.
    pub fn write_evaluation(&mut self, evaluation: &EvaluationReport) -> Result<(), RunError> {
        let results = &evaluation.results;
        let row = |score| score_row(evaluation, score);
        self.scores.append_rows(results.scores.iter().map(row))?;
        let (rollouts, decisions) = (evaluation.rollouts, evaluation.decisions);
        self.units.append_rows(results.dormant_unit_rows(rollouts, decisions))?;
        self.recognition.append_rows(&results.recognitions)
    }
}

/// Returns the row of `timings.csv` for one iteration: its seconds and those of its parts.
fn timing_row(progress: &RolloutReport) -> TimingRow {
    let seconds = &progress.iteration.seconds;
    TimingRow {
        rollout: progress.rollout,
        decisions: progress.iteration.decisions,
        total: progress.seconds,
        environments: progress.environment_seconds,
        inference: seconds.collection - progress.environment_seconds,
        assignment: seconds.assignment,
        update: seconds.update,
    }
}

fn score_row(evaluation: &EvaluationReport, score: &VariantScore) -> ScoreRow {
    ScoreRow {
        rollouts: evaluation.rollouts,
        decisions: evaluation.decisions,
        group: score.group.name().to_owned(),
        element: score.element.to_string(),
        seen_in_training: score.seen_in_training,
        policy: Some(score.policy),
        episodes: score.episodes,
        success: score.success,
        success_at_end: score.success_at_end,
        reward: score.reward,
        own_policy: score.own_policy_score.map(|own| own.policy),
        own_success: score.own_policy_score.map(|own| own.success),
        own_success_at_end: score.own_policy_score.map(|own| own.success_at_end),
        own_reward: score.own_policy_score.map(|own| own.reward),
    }
}

/// Returns the names and cells of one rollout's row in `metrics.csv`: the columns of every learner,
/// then the metrics that this learner logs.
fn row(progress: &RolloutReport) -> Vec<(String, String)> {
    let iteration = &progress.iteration;
    let number = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
    let known = [
        ("rollout", progress.rollout.to_string()),
        ("decisions", progress.decisions.to_string()),
        ("group", progress.group.name().to_owned()),
        ("last_group", progress.last_group.name().to_owned()),
        ("straddles", progress.spans_switch.to_string()),
        ("policy", iteration.policy.to_string()),
        ("created", iteration.policy_created.to_string()),
        ("reward", number(progress.scaled_mean_return())),
        ("success", number(progress.success_rate())),
        ("success_at_end", number(iteration.rollout_stats.success_at_end_rate())),
    ];
    let metrics = iteration.metrics.iter().map(|(name, metric)| (name, metric.to_string()));
    known.into_iter().chain(metrics).map(|(name, cell)| (name.to_owned(), cell)).collect()
}

#[cfg(test)]
mod tests {
    use envs::TaskGroup;
    use symmetry::D2;

    use super::*;
    use crate::evaluation::{EvaluationResults, PolicyScore};

    #[test]
    fn scores_end_with_those_of_the_groups_own_policy() {
        let evaluation =
            EvaluationReport { rollouts: 3, decisions: 240, results: EvaluationResults::default() };
        let score = |own| VariantScore {
            group: TaskGroup::GOAL_REACH,
            element: D2::FlipX,
            seen_in_training: true,
            policy: 1,
            episodes: 4,
            success: 0.5,
            success_at_end: 0.25,
            reward: 100.0,
            own_policy_score: own,
        };
        let own = PolicyScore { policy: 0, success: 1.0, success_at_end: 0.75, reward: 400.5 };
        let mut writer = csv::Writer::from_writer(Vec::new());
        for scored in [score(None), score(Some(own))] {
            writer.serialize(score_row(&evaluation, &scored)).unwrap();
        }
        let text = String::from_utf8(writer.into_inner().unwrap()).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].ends_with("reward,own_policy,own_success,own_success_at_end,own_reward"));
        assert_eq!(lines[1], "3,240,goal-reach,flip x,true,1,4,0.5,0.25,100.0,,,,");
        let expected = "3,240,goal-reach,flip x,true,1,4,0.5,0.25,100.0,0,1.0,0.75,400.5";
        assert_eq!(lines[2], expected);
    }
}
