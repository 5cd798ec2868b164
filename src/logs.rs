//! The CSV files of a run. Those of metrics and scores hold no clock time, so equal runs give equal bytes.

use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use cluster::{Evidence, PermutationTest};
use serde::{Deserialize, Serialize};

use crate::CoversError;
use crate::evaluation::Score;
use crate::progress::Progress;

/// The open files; every row reaches the disk before the next rollout.
pub(crate) struct Logs {
    metrics: Log,
    scores: Log,
    timings: Log,
}

/// Lengths of the files in bytes: rows behind them are forgotten when a run goes on from a checkpoint.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Marks {
    metrics: u64,
    scores: u64,
    timings: u64,
}

impl Logs {
    /// Creates `metrics.csv`, one row a rollout, `evaluation.csv`, one row a variant, and `timings.csv`, one row a rollout; or opens
    /// those of an interrupted run and cuts them to `marks`.
    pub(crate) fn open(folder: &Path, marks: Option<Marks>) -> Result<Self, CoversError> {
        let open =
            |name: &str, mark: fn(Marks) -> u64| Log::open(folder.join(name), marks.map(mark));
        Ok(Self {
            metrics: open("metrics.csv", |marks| marks.metrics)?,
            scores: open("evaluation.csv", |marks| marks.scores)?,
            timings: open("timings.csv", |marks| marks.timings)?,
        })
    }

    /// How long the files are.
    pub(crate) fn marks(&self) -> Result<Marks, CoversError> {
        Ok(Marks {
            metrics: self.metrics.length()?,
            scores: self.scores.length()?,
            timings: self.timings.length()?,
        })
    }

    /// Adds the row of a rollout.
    pub(crate) fn write_rollout(&mut self, progress: &Progress) -> Result<(), CoversError> {
        self.metrics.write([Row::new(progress)])?;
        self.timings.write([Timing::new(progress)])
    }

    /// Adds the rows of an evaluation.
    pub(crate) fn write_scores(&mut self, progress: &Progress) -> Result<(), CoversError> {
        let row = |score| ScoreRow::new(progress, score);
        self.scores.write(progress.scores.iter().map(row))
    }
}

/// One CSV file.
struct Log {
    path: PathBuf,
    writer: csv::Writer<File>,
}

impl Log {
    /// Creates the file, or opens it, cut to `mark` bytes.
    fn open(path: PathBuf, mark: Option<u64>) -> Result<Self, CoversError> {
        let file = match mark {
            None => File::create(&path).map_err(|error| CoversError::write(&path, error))?,
            Some(mark) => cut(&path, mark)?,
        };
        let headers = mark.unwrap_or(0) == 0;
        let writer = csv::WriterBuilder::new()
            .has_headers(headers)
            .from_writer(file);
        Ok(Self { path, writer })
    }

    fn write<R: Serialize>(
        &mut self,
        rows: impl IntoIterator<Item = R>,
    ) -> Result<(), CoversError> {
        let (path, writer) = (&self.path, &mut self.writer);
        rows.into_iter()
            .try_for_each(|row| writer.serialize(row))
            .map_err(|error| CoversError::write(path, error))?;
        writer
            .flush()
            .map_err(|error| CoversError::write(path, error))
    }

    fn length(&self) -> Result<u64, CoversError> {
        let metadata = self.writer.get_ref().metadata();
        let metadata = metadata.map_err(|error| CoversError::write(&self.path, error))?;
        Ok(metadata.len())
    }
}

/// Opens a file of at least `mark` bytes and forgets those behind.
fn cut(path: &Path, mark: u64) -> Result<File, CoversError> {
    let read = |error| CoversError::read(path, error);
    let mut file = OpenOptions::new().write(true).open(path).map_err(read)?;
    let length = file.metadata().map_err(read)?.len();
    // a longer length would fill the gap with zeros
    if length < mark {
        let problem = format!(
            "it holds {length} bytes, the checkpoint expects at least {mark}: put the whole file back"
        );
        return Err(read(Error::new(ErrorKind::UnexpectedEof, problem)));
    }
    file.set_len(mark)
        .and_then(|()| file.seek(SeekFrom::End(0)))
        .map_err(|error| CoversError::write(path, error))?;
    Ok(file)
}

/// One evaluated variant.
#[derive(Serialize)]
struct ScoreRow<'a> {
    rollout: usize,
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
    fn new(progress: &Progress, score: &'a Score) -> Self {
        Self {
            rollout: progress.rollout,
            decisions: progress.decisions,
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
#[derive(Serialize)]
struct Timing {
    rollout: usize,
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
        let seconds = &progress.report.seconds;
        Self {
            rollout: progress.rollout,
            total: progress.seconds,
            environments: progress.environment_seconds,
            inference: seconds.collection - progress.environment_seconds,
            assignment: seconds.assignment,
            update: seconds.update,
        }
    }
}

/// One rollout.
#[derive(Serialize)]
struct Row<'a> {
    rollout: usize,
    decisions: usize,
    group: &'a str,
    policy: usize,
    created: bool,
    /// Rollouts that the assignment looked at: 2 where the first left it undecided.
    looks: u8,
    /// W1 to each policy that existed before, and what the permutation test made of it; joined by semicolons.
    distances: String,
    null_means: String,
    null_maxima: String,
    scores: String,
    p_values: String,
    tail_p_values: String,
    reward: Option<f64>,
    success: Option<f64>,
    success_at_end: Option<f64>,
    policy_loss: f64,
    value_loss: f64,
    entropy: f64,
    approx_kl: f64,
    clip_fraction: f64,
    explained_variance: f64,
    grad_norm: f64,
    epochs: usize,
}

impl<'a> Row<'a> {
    fn new(progress: &'a Progress) -> Self {
        let (report, update) = (&progress.report, &progress.report.update);
        let tests = |figure: fn(&PermutationTest) -> f64| {
            let tests = report.evidence.iter().map(Evidence::test);
            join(tests.map(|test| test.map(figure)))
        };
        Self {
            rollout: progress.rollout,
            decisions: progress.decisions,
            group: progress.group.name(),
            policy: report.policy,
            created: report.created,
            looks: 1 + u8::from(report.first_look.is_some()),
            distances: join(report.evidence.iter().map(|e| Some(e.distance))),
            null_means: tests(|test| test.null.mean),
            null_maxima: tests(|test| test.null.max),
            scores: tests(|test| test.score),
            p_values: tests(|test| test.p_value),
            tail_p_values: tests(|test| test.tail_p_value),
            reward: progress.reward,
            success: progress.success,
            success_at_end: report.rollout.success_at_end_rate(),
            policy_loss: update.policy_loss,
            value_loss: update.value_loss,
            entropy: update.entropy,
            approx_kl: update.approx_kl,
            clip_fraction: update.clip_fraction,
            explained_variance: update.explained_variance,
            grad_norm: update.grad_norm,
            epochs: update.epochs,
        }
    }
}

fn join(values: impl Iterator<Item = Option<f64>>) -> String {
    let texts: Vec<String> = values
        .map(|value| value.map_or_else(String::new, |value| value.to_string()))
        .collect();
    texts.join(";")
}
