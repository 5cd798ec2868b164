//! The CSV files of a run. Those of metrics and scores hold no clock time, so equal runs give equal
//! bytes.

use serde::{Deserialize, Serialize};

use crate::error::CoversError;
use crate::evaluation::Score;

use super::folder::RunFolder;
use super::progress::{Evaluation, Progress};
use super::table::Table;

const TIMINGS: &str = "timings.csv";

/// The files; every row is written before the next rollout.
pub(super) struct Logs {
    metrics: Table,
    scores: Table,
    timings: Table,
}

/// What a checkpoint keeps of the files, so that a run can go on where they are lost.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Rows {
    metrics: String,
    scores: String,
}

impl Logs {
    /// Makes `metrics.csv` and `timings.csv`, one row a rollout, and `evaluation.csv`, one row a
    /// variant, hold what they held after this many rollouts.
    pub fn open(folder: &RunFolder, rollouts: usize, rows: Rows) -> Result<Self, CoversError> {
        let open = |name: &str, text: String| {
            Table::open(folder.file(name), folder.shared_disk(), text.into_bytes())
        };
        let timings = std::fs::read(folder.file(TIMINGS)).unwrap_or_default();
        Ok(Self {
            metrics: open("metrics.csv", rows.metrics)?,
            scores: open("evaluation.csv", rows.scores)?,
            timings: open(TIMINGS, first_rows(&timings, rollouts))?,
        })
    }

    /// What a checkpoint keeps.
    pub fn rows(&self) -> Rows {
        let text = |table: &Table| String::from_utf8_lossy(table.text()).into_owned();
        Rows {
            metrics: text(&self.metrics),
            scores: text(&self.scores),
        }
    }

    /// Seconds of learning so far, as far as they are known.
    pub fn seconds(&self) -> f64 {
        self.known_timings().iter().map(|timing| timing.total).sum()
    }

    /// Decisions per second over the rollouts whose seconds are known.
    pub fn decisions_per_second(&self) -> Option<f64> {
        let timings = self.known_timings();
        let decisions: usize = timings.iter().map(|timing| timing.decisions).sum();
        (!timings.is_empty()).then(|| decisions as f64 / self.seconds())
    }

    fn known_timings(&self) -> Vec<Timing> {
        let mut reader = csv::Reader::from_reader(self.timings.text());
        reader.deserialize().map_while(Result::ok).collect()
    }

    /// Brings all rows to the disk.
    pub fn sync(&self) -> Result<(), CoversError> {
        [&self.metrics, &self.scores, &self.timings]
            .into_iter()
            .try_for_each(Table::sync)
    }

    /// Adds the row of a rollout.
    pub fn write_rollout(&mut self, progress: &Progress) -> Result<(), CoversError> {
        self.metrics.write_named(row(progress))?;
        self.timings.write([Timing::new(progress)])
    }

    /// Adds the rows of an evaluation.
    pub fn write_scores(&mut self, evaluation: &Evaluation) -> Result<(), CoversError> {
        let row = |score| ScoreRow::new(evaluation, score);
        self.scores.write(evaluation.scores.iter().map(row))
    }
}

/// The header and those rows of a file of timings that are whole and of the first rollouts: the one
/// file that no checkpoint holds, since clocks differ between equal runs.
fn first_rows(timings: &[u8], rollouts: usize) -> String {
    let text = String::from_utf8_lossy(timings);
    let mut lines = text.split_inclusive('\n');
    let Some(header) = lines.next().filter(|line| line.ends_with('\n')) else {
        return String::new();
    };
    let commas = |line: &str| line.matches(',').count();
    let mut kept = header.to_owned();
    for row in lines {
        let rollout = row.split(',').next().and_then(|cell| cell.parse().ok());
        let early = rollout.is_some_and(|rollout: usize| rollout < rollouts);
        if early && row.ends_with('\n') && commas(row) == commas(header) {
            kept.push_str(row);
        }
    }
    kept
}

/// One evaluated variant.
#[derive(Serialize)]
struct ScoreRow<'a> {
    rollouts: usize,
    decisions: usize,
    group: &'a str,
    element: String,
    seen: bool,
    policy: usize,
    episodes: usize,
    success: f64,
    success_at_end: f64,
    reward: f64,
}

impl<'a> ScoreRow<'a> {
    fn new(evaluation: &Evaluation, score: &'a Score) -> Self {
        Self {
            rollouts: evaluation.rollouts,
            decisions: evaluation.decisions,
            group: score.group.name(),
            element: score.element.to_string(),
            seen: score.seen,
            policy: score.policy,
            episodes: score.episodes,
            success: score.success,
            success_at_end: score.success_at_end,
            reward: score.reward,
        }
    }
}

/// Where the seconds of one rollout went.
#[derive(Serialize, Deserialize)]
struct Timing {
    rollout: usize,
    /// Those of this rollout.
    decisions: usize,
    total: f64,
    /// Physics and pictures.
    environments: f64,
    /// The policy's decisions.
    inference: f64,
    assignment: f64,
    update: f64,
}

impl Timing {
    fn new(progress: &Progress) -> Self {
        let seconds = &progress.turn.seconds;
        Self {
            rollout: progress.rollout,
            decisions: progress.turn.decisions,
            total: progress.seconds,
            environments: progress.environment_seconds,
            inference: seconds.collection - progress.environment_seconds,
            assignment: seconds.assignment,
            update: seconds.update,
        }
    }
}

/// The row of one rollout: what a run knows of every learner, then what this learner logs.
fn row(progress: &Progress) -> Vec<(String, String)> {
    let turn = &progress.turn;
    let number = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
    let known = [
        ("rollout", progress.rollout.to_string()),
        ("decisions", progress.decisions.to_string()),
        ("group", progress.group.name().to_owned()),
        ("last_group", progress.last_group.name().to_owned()),
        ("straddles", progress.straddles.to_string()),
        ("policy", turn.policy.to_string()),
        ("created", turn.created.to_string()),
        ("reward", number(progress.reward())),
        ("success", number(progress.success())),
        ("success_at_end", number(turn.rollout.success_at_end_rate())),
    ];
    let known = known.map(|(name, cell)| (name.to_owned(), cell));
    let logged = turn.metrics.iter();
    let logged = logged.map(|(name, metric)| (name.to_owned(), metric.to_string()));
    known.into_iter().chain(logged).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn timings_are_kept_up_to_the_checkpoint() {
        let text = "rollout,total\n0,1.5\n1,2.5\n2,3.5\n";
        let kept = |text: &str, rollouts| first_rows(text.as_bytes(), rollouts);
        assert_eq!(kept(text, 2), "rollout,total\n0,1.5\n1,2.5\n");
        assert_eq!(kept(text, 9), text);
        assert_eq!(kept(&text[..text.len() - 1], 9), kept(text, 2));
        let gap = text.replace("1,2.5\n", "");
        assert_eq!(kept(&gap, 9), gap);
        assert_eq!((kept("", 2), kept("rollout,to", 2)), Default::default());
    }
}
