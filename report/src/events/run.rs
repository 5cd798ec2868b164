//! Conversion of a run's tables to TensorBoard events.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ffi::OsString;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use csv::StringRecord;

use crate::ReportError;
use experiments::{RunError, RunFolder};
use learner::disk::{LocalDisk, write_atomically};
use learner::per_policy_metric_names;

use super::summary::{EventFile, EventTime};

/// Name of an event file. TensorBoard finds files by the part `tfevents`. A fixed name, and seconds
/// of learning as wall-clock times, make files of equal runs equal but for these seconds.
const FILE: &str = "events.out.tfevents.0.covers";
/// Names of columns that hold the time of a table's row, not a value.
const TIME_COLUMNS: [&str; 3] = ["rollout", "rollouts", "decisions"];
/// Names of the columns of scores. Scores of the group's own policy are empty before it has one.
const SCORE_COLUMNS: [&str; 6] =
    ["success", "success_at_end", "reward", "own_success", "own_success_at_end", "own_reward"];
/// Time of events before the first rollout.
const START: EventTime = EventTime { step: 0, learning_seconds: 0.0 };

/// Writes a TensorBoard event file for each run, finished or not, to a folder of the run's name in
/// `folder`, and returns the paths. Existing event files are replaced.
///
/// # Errors
/// [`RunError::NoRun`] for a folder without a run, [`ReportError::DuplicateRunName`] for two runs
/// of one name, [`RunError::ChangedTable`] for a finished run whose table is damaged or missing,
/// [`RunError::Read`] for a row with too few or too many cells, [`RunError::Write`].
pub fn write_tensorboard_events(
    runs: &[PathBuf],
    folder: &Path,
) -> Result<Vec<PathBuf>, ReportError> {
    let mut named: BTreeMap<OsString, &PathBuf> = BTreeMap::new();
    for run in runs {
        if let Some(other) = named.insert(name(run)?, run) {
            let (first, second) = (other.clone(), run.clone());
            return Err(ReportError::DuplicateRunName { first, second });
        }
    }
    runs.iter()
        .map(|run| write(run, &folder.join(name(run)?)))
        .collect::<Result<_, _>>()
        .map_err(ReportError::from)
}

/// Returns the name of a run's folder.
fn name(run: &Path) -> Result<OsString, RunError> {
    let folder = RunFolder::from_path(run);
    if !folder.holds_run() {
        return Err(folder.no_run());
    }
    if folder.is_packed() {
        return Err(RunError::PackedRun { folder: run.to_owned() });
    }
    // a path such as `.` or `runs/..` has no name of its own
    let path = run.canonicalize().map_err(RunError::read_error_mapper(run))?;
    Ok(path.file_name().unwrap_or(path.as_os_str()).to_owned())
}

fn write(run: &Path, own: &Path) -> Result<PathBuf, RunError> {
    let bytes = events(&RunFolder::from_path(run))?;
    fs::create_dir_all(own).map_err(RunError::write_error_mapper(own))?;
    let path = own.join(FILE);
    write_atomically(&LocalDisk, &path, &bytes)?;
    Ok(path)
}

fn events(run: &RunFolder) -> Result<Vec<u8>, RunError> {
    if run.is_finished() {
        run.verify_table_checksums()?;
    }
    let read = |name| Rows::read(&run.file_path(name));
    let (metrics, timings) = (read("metrics.csv")?, read("timings.csv")?);
    let clock = Clock::of(&metrics, &timings);
    let mut file = EventFile::new();
    picture(run, &mut file)?;
    for row in &metrics.rows {
        let time = clock.after(metrics.rollouts(row));
        for (name, cell) in metrics.values(row) {
            if metrics.lists.contains(name) {
                add_list(&mut file, time, name, cell);
            } else {
                add_number(&mut file, time, name, cell);
            }
        }
    }
    for row in &timings.rows {
        let time = clock.after(timings.rollouts(row));
        for (name, cell) in timings.values(row) {
            add_number(&mut file, time, &format!("seconds/{name}"), cell);
        }
    }
    scores(&read("evaluation.csv")?, &clock, &mut file);
    Ok(file.into_bytes())
}

/// Adds a table's cell as a scalar event if the cell is a number.
fn add_number(file: &mut EventFile, time: EventTime, name: &str, cell: &str) {
    if let Some(value) = number(cell) {
        file.add_scalar(time, name, value);
    }
}

/// Adds events for a cell that holds one number for each policy, separated by semicolons: a scalar
/// for each policy, and their histogram.
fn add_list(file: &mut EventFile, time: EventTime, name: &str, cell: &str) {
    let values: Vec<Option<f64>> = cell.split(';').map(number).collect();
    for (policy, value) in values.iter().enumerate() {
        if let Some(value) = value {
            file.add_scalar(time, &format!("{name}/policy {policy}"), *value);
        }
    }
    let known: Vec<f64> = values.into_iter().flatten().collect();
    file.add_histogram(time, name, &known);
}

/// Parses a table's cell: a finite number, or 0 and 1 for `false` and `true`; else `None`.
fn number(cell: &str) -> Option<f64> {
    match cell {
        "false" => Some(0.0),
        "true" => Some(1.0),
        _ => cell.parse().ok().filter(|value: &f64| value.is_finite()),
    }
}

/// Adds events for the scores of task variants, and for their means by group.
fn scores(table: &Rows, clock: &Clock, file: &mut EventFile) {
    let mut groups: BTreeMap<(usize, String), Vec<f64>> = BTreeMap::new();
    for row in &table.rows {
        let cell = |name| table.cell(row, name);
        let rollouts = cell("rollouts").parse().unwrap_or(0);
        for column in SCORE_COLUMNS {
            let Some(value) = number(cell(column)) else {
                continue;
            };
            let group = format!("evaluation/{}/{column}", cell("group"));
            let variant = format!("{group}/{}", cell("element"));
            file.add_scalar(clock.after(rollouts), &variant, value);
            groups.entry((rollouts, group)).or_default().push(value);
        }
    }
    for ((rollouts, tag), values) in groups {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        file.add_scalar(clock.after(rollouts), &tag, mean);
    }
}

fn picture(run: &RunFolder, file: &mut EventFile) -> Result<(), RunError> {
    let path = run.file_path("contact_sheet.png");
    let Some(png) = read_optional(&path)? else {
        return Ok(());
    };
    let reader = png::Decoder::new(std::io::Cursor::new(&png))
        .read_info()
        .map_err(RunError::read_error_mapper(&path))?;
    let sides = [reader.info().height, reader.info().width];
    file.add_image(START, "variants", sides, &png);
    Ok(())
}

/// Decisions and seconds of learning after each rollout of `metrics.csv`, by number of rollouts.
struct Clock(BTreeMap<usize, EventTime>);

impl Clock {
    /// Joins the rows of `metrics.csv` and `timings.csv` by their rollouts.
    fn of(metrics: &Rows, timings: &Rows) -> Self {
        // not by their order: either table may have gaps or begin later
        let seconds = timings.rows.iter().filter_map(|row| {
            let seconds = number(timings.cell(row, "total"))?;
            Some((timings.rollouts(row), seconds))
        });
        let seconds: HashMap<usize, f64> = seconds.collect();
        let mut now = START;
        let mut times = BTreeMap::new();
        for row in &metrics.rows {
            let rollouts = metrics.rollouts(row);
            now.step = metrics.cell(row, "decisions").parse().unwrap_or(now.step);
            now.learning_seconds += seconds.get(&rollouts).unwrap_or(&0.0);
            times.insert(rollouts, now);
        }
        Self(times)
    }

    /// Returns the time after a number of rollouts, or the last known time before.
    fn after(&self, rollouts: usize) -> EventTime {
        let known = self.0.range(..=rollouts).next_back();
        known.map_or(START, |(_, &time)| time)
    }
}

/// Rows of a table, as text.
struct Rows {
    names: StringRecord,
    /// Names of the columns whose cells hold one number for each policy.
    lists: BTreeSet<String>,
    rows: Vec<StringRecord>,
}

impl Rows {
    fn read(path: &Path) -> Result<Self, RunError> {
        let text = read_optional(path)?.unwrap_or_default();
        // a row that is being written ends without a line feed
        let end = text.iter().rposition(|&byte| byte == b'\n');
        let whole = &text[..end.map_or(0, |end| end + 1)];
        let mut reader = csv::Reader::from_reader(whole);
        let read_error = |error| RunError::cannot_read(path, error);
        let names = reader.headers().map_err(read_error)?.clone();
        let rows = reader.records().collect::<Result<Vec<_>, _>>().map_err(read_error)?;
        // a column of lists has cells without a semicolon while there is one policy
        let cells = rows.iter().flat_map(|row| names.iter().zip(row));
        let with_lists = cells.filter(|(_, cell)| cell.contains(';'));
        let with_lists = with_lists.map(|(name, _)| name.to_owned());
        let lists = with_lists.chain(per_policy_metric_names().map(str::to_owned)).collect();
        Ok(Self { names, lists, rows })
    }

    /// Returns the cell of a row in the column `name`; empty if there is no such column.
    fn cell<'a>(&self, row: &'a StringRecord, name: &str) -> &'a str {
        let column = self.names.iter().position(|column| column == name);
        column.and_then(|column| row.get(column)).unwrap_or("")
    }

    /// Returns the number of rollouts up to and including that of a row, whose index counts from 0.
    fn rollouts(&self, row: &StringRecord) -> usize {
        let rollout = self.cell(row, "rollout").parse::<usize>();
        rollout.map_or(0, |rollout| rollout.saturating_add(1))
    }

    /// Returns the cells of a row with the names of their columns, without [`TIME_COLUMNS`].
    fn values<'a>(&'a self, row: &'a StringRecord) -> impl Iterator<Item = (&'a str, &'a str)> {
        let cells = self.names.iter().zip(row);
        cells.filter(|(name, _)| !TIME_COLUMNS.contains(name))
    }
}

/// Reads a file that not every run has; `None` if it does not exist.
fn read_optional(path: &Path) -> Result<Option<Vec<u8>>, RunError> {
    match fs::read(path) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(RunError::cannot_read(path, error)),
    }
}
