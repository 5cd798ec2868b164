//! The CSV files of a run. Those of metrics and scores hold no clock time, so equal runs give equal
//! bytes.

use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::error::CoversError;
use crate::evaluation::Score;
use crate::progress::Progress;

/// The open files; every row reaches the disk before the next rollout.
pub(crate) struct Logs {
    metrics: Log,
    scores: Log,
    timings: Log,
}

/// Lengths of the files in bytes: rows behind them are forgotten when a run goes on from a
/// checkpoint.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Marks {
    metrics: u64,
    scores: u64,
    timings: u64,
}

impl Logs {
    /// Creates `metrics.csv` and `timings.csv`, one row a rollout, and `evaluation.csv`, one row a
    /// variant; or opens those of an interrupted run and cuts them to `marks`.
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
        self.metrics.write_named(row(progress))?;
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
    /// Names of the columns of a file whose rows are written by name, once there are any.
    names: Vec<String>,
}

impl Log {
    /// Creates the file, or opens it, cut to `mark` bytes.
    fn open(path: PathBuf, mark: Option<u64>) -> Result<Self, CoversError> {
        let file = match mark {
            None => File::create(&path).map_err(|error| CoversError::write(&path, error))?,
            Some(mark) => cut(&path, mark)?,
        };
        let empty = mark.unwrap_or(0) == 0;
        let names = if empty { Vec::new() } else { header(&path)? };
        let writer = csv::WriterBuilder::new()
            .has_headers(empty)
            .from_writer(file);
        Ok(Self {
            path,
            writer,
            names,
        })
    }

    /// Adds one row of named cells. All rows of a file have the same names.
    fn write_named(&mut self, row: Vec<(String, String)>) -> Result<(), CoversError> {
        let (names, cells): (Vec<String>, Vec<String>) = row.into_iter().unzip();
        let (path, writer) = (&self.path, &mut self.writer);
        let write = |error: csv::Error| CoversError::write(path, error);
        if let Some(twice) = (1..names.len()).find(|&i| names[..i].contains(&names[i])) {
            let problem = format!("two columns are called `{}`", names[twice]);
            return Err(CoversError::write(path, Error::other(problem)));
        }
        if self.names.is_empty() {
            writer.write_record(&names).map_err(write)?;
            self.names = names;
        } else if self.names != names {
            let problem = format!(
                "a row of {names:?} does not fit the columns {:?}",
                self.names
            );
            return Err(CoversError::write(path, Error::other(problem)));
        }
        writer.write_record(&cells).map_err(write)?;
        writer
            .flush()
            .map_err(|error| CoversError::write(path, error))
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

/// The names of a file's columns.
fn header(path: &Path) -> Result<Vec<String>, CoversError> {
    let read = |error| CoversError::read(path, error);
    let mut reader = csv::Reader::from_path(path).map_err(read)?;
    let names = reader.headers().map_err(read)?;
    Ok(names.iter().map(str::to_owned).collect())
}

/// Whether the first `mark` bytes of a file end with a row.
fn ends_line(path: &Path, mark: u64) -> std::io::Result<bool> {
    let mut file = File::open(path)?;
    file.seek(SeekFrom::Start(mark - 1))?;
    let mut last = [0];
    file.read_exact(&mut last)?;
    Ok(last == *b"\n")
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
    if mark > 0 && !ends_line(path, mark).map_err(read)? {
        let problem = format!("byte {mark}, where the checkpoint ends, is no end of a row");
        return Err(read(Error::new(ErrorKind::InvalidData, problem)));
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
        let seconds = &progress.turn.seconds;
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

/// The row of one rollout: what a run knows of every learner, then what this learner logs.
fn row(progress: &Progress) -> Vec<(String, String)> {
    let turn = &progress.turn;
    let number = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
    let known = [
        ("rollout", progress.rollout.to_string()),
        ("decisions", progress.decisions.to_string()),
        ("group", progress.group.name().to_owned()),
        ("policy", turn.policy.to_string()),
        ("created", turn.created.to_string()),
        ("reward", number(progress.reward)),
        ("success", number(progress.success)),
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

    fn cells(row: &[(&str, &str)]) -> Vec<(String, String)> {
        let row = row.iter();
        row.map(|(name, cell)| (name.to_string(), cell.to_string()))
            .collect()
    }

    #[test]
    fn rows_of_other_columns_are_refused_also_after_a_resumption() {
        let path = std::env::temp_dir().join(format!("covers-log-{}.csv", std::process::id()));
        let mut log = Log::open(path.clone(), None).unwrap();
        log.write_named(cells(&[("rollout", "0"), ("loss", "1.5")]))
            .unwrap();
        let length = log.length().unwrap();
        let mut resumed = Log::open(path.clone(), Some(length)).unwrap();
        let other = [("rollout", "1"), ("entropy", "2")];
        for log in [&mut log, &mut resumed] {
            let message = log.write_named(cells(&other)).unwrap_err().to_string();
            assert!(message.contains("entropy") && message.contains("loss"));
        }
        let same = cells(&[("rollout", "1"), ("loss", "2")]);
        resumed.write_named(same).unwrap();
        let twice = cells(&[("rollout", "1"), ("rollout", "2")]);
        let message = log.write_named(twice).unwrap_err().to_string();
        assert!(
            message.contains("two columns are called `rollout`"),
            "{message}"
        );
        let inside = Log::open(path.clone(), Some(length - 1)).err().unwrap();
        assert!(inside.to_string().contains("no end of a row"), "{inside}");
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(text, "rollout,loss\n0,1.5\n1,2\n");
        std::fs::remove_file(path).unwrap();
    }
}
