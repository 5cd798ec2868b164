//! The tables of a run as events.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ffi::OsString;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use csv::{ReaderBuilder, StringRecord};

use crate::ReportError;
use experiments::{RunError, RunFolder};
use learner::disk::{LocalDisk, replace};
use learner::per_policy_columns;

use super::summary::{EventFile, Moment};

/// The name of the file; TensorBoard looks for the middle of it. Wall-clock times in it are seconds
/// of learning, so equal runs give equal files but for those.
const FILE: &str = "events.out.tfevents.0.covers";
/// Columns that say when a row was, and no figures.
const MOMENTS: [&str; 3] = ["rollout", "rollouts", "decisions"];
/// Columns of scores; those of the group's own policy are empty before it has one.
const SCORES: [&str; 6] =
    ["success", "success_at_end", "reward", "own_success", "own_success_at_end", "own_reward"];
/// Before the first rollout.
const START: Moment = Moment { step: 0, seconds: 0.0 };

/// Writes the event file of each run, finished or not, to a folder of the run's name in `folder`;
/// one that is there is replaced. Returns where they are.
///
/// # Errors
/// [`RunError::NoRun`], [`ReportError::SameName`], [`RunError::Read`],
/// [`RunError::Write`].
pub fn write_events(runs: &[PathBuf], folder: &Path) -> Result<Vec<PathBuf>, ReportError> {
    let mut named: BTreeMap<OsString, &PathBuf> = BTreeMap::new();
    for run in runs {
        if let Some(other) = named.insert(name(run)?, run) {
            let (first, second) = (other.clone(), run.clone());
            return Err(ReportError::SameName { first, second });
        }
    }
    let runs = runs.iter();
    runs.map(|run| write(run, &folder.join(name(run)?)))
        .collect::<Result<_, _>>()
        .map_err(ReportError::from)
}

/// The name of a run's folder.
fn name(run: &Path) -> Result<OsString, RunError> {
    if !RunFolder::open(run).holds_run() {
        let folder = run.to_owned();
        return Err(RunError::NoRun { folder });
    }
    let whole = run.canonicalize();
    let whole = whole.map_err(|error| RunError::read(run, error))?;
    Ok(whole.file_name().unwrap_or(whole.as_os_str()).to_owned())
}

fn write(run: &Path, own: &Path) -> Result<PathBuf, RunError> {
    let bytes = events(&RunFolder::open(run))?;
    fs::create_dir_all(own).map_err(|error| RunError::write(own, error))?;
    let path = own.join(FILE);
    replace(&LocalDisk, &path, &bytes)?;
    Ok(path)
}

fn events(run: &RunFolder) -> Result<Vec<u8>, RunError> {
    let read = |name| Rows::read(&run.file(name));
    let (metrics, timings) = (read("metrics.csv")?, read("timings.csv")?);
    let clock = Clock::of(&metrics, &timings);
    let mut file = EventFile::new();
    picture(run, &mut file)?;
    for row in &metrics.rows {
        let moment = clock.after(metrics.rollouts(row));
        for (name, cell) in metrics.figures(row) {
            match metrics.lists.contains(name) {
                true => by_policy(&mut file, moment, name, cell),
                false => figure(&mut file, moment, name, cell),
            }
        }
    }
    for row in &timings.rows {
        let moment = clock.after(timings.rollouts(row));
        for (name, cell) in timings.figures(row) {
            figure(&mut file, moment, &format!("seconds/{name}"), cell);
        }
    }
    scores(&read("evaluation.csv")?, &clock, &mut file);
    Ok(file.into_bytes())
}

/// Adds a cell of a table, where it is a number.
fn figure(file: &mut EventFile, moment: Moment, name: &str, cell: &str) {
    if let Some(value) = number(cell) {
        file.scalar(moment, name, value);
    }
}

/// Adds a cell of numbers with semicolons between them, one a policy.
fn by_policy(file: &mut EventFile, moment: Moment, name: &str, cell: &str) {
    let values: Vec<Option<f64>> = cell.split(';').map(number).collect();
    for (policy, value) in values.iter().enumerate() {
        if let Some(value) = value {
            file.scalar(moment, &format!("{name}/policy {policy}"), *value);
        }
    }
    let known: Vec<f64> = values.into_iter().flatten().collect();
    file.histogram(moment, name, &known);
}

/// A finite number, or 0 and 1 for false and true.
fn number(cell: &str) -> Option<f64> {
    match cell {
        "false" => Some(0.0),
        "true" => Some(1.0),
        _ => cell.parse().ok().filter(|value: &f64| value.is_finite()),
    }
}

/// Adds the scores of variants, and their means by group.
fn scores(table: &Rows, clock: &Clock, file: &mut EventFile) {
    let mut groups: BTreeMap<(usize, String), Vec<f64>> = BTreeMap::new();
    for row in &table.rows {
        let cell = |name| table.cell(row, name);
        let rollouts = cell("rollouts").parse().unwrap_or(0);
        for figure in SCORES {
            let Some(value) = number(cell(figure)) else {
                continue;
            };
            let group = format!("evaluation/{}/{figure}", cell("group"));
            let variant = format!("{group}/{}", cell("element"));
            file.scalar(clock.after(rollouts), &variant, value);
            groups.entry((rollouts, group)).or_default().push(value);
        }
    }
    for ((rollouts, tag), values) in groups {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        file.scalar(clock.after(rollouts), &tag, mean);
    }
}

fn picture(run: &RunFolder, file: &mut EventFile) -> Result<(), RunError> {
    let path = run.file("contact_sheet.png");
    let Some(png) = if_there(&path)? else {
        return Ok(());
    };
    let reader = png::Decoder::new(std::io::Cursor::new(&png)).read_info();
    let reader = reader.map_err(|error| RunError::read(&path, error))?;
    let sides = [reader.info().height, reader.info().width];
    file.image(START, "variants", sides, &png);
    Ok(())
}

/// Decisions and seconds after so many rollouts, for those that the metrics hold.
struct Clock(BTreeMap<usize, Moment>);

impl Clock {
    /// Rows belong together by their rollouts: either table may have gaps or begin later.
    fn of(metrics: &Rows, timings: &Rows) -> Self {
        let seconds = timings.rows.iter().filter_map(|row| {
            let seconds = number(timings.cell(row, "total"))?;
            Some((timings.rollouts(row), seconds))
        });
        let seconds: HashMap<usize, f64> = seconds.collect();
        let mut now = START;
        let mut moments = BTreeMap::new();
        for row in &metrics.rows {
            let rollouts = metrics.rollouts(row);
            now.step = metrics.cell(row, "decisions").parse().unwrap_or(now.step);
            now.seconds += seconds.get(&rollouts).unwrap_or(&0.0);
            moments.insert(rollouts, now);
        }
        Self(moments)
    }

    /// The last moment that is known until then.
    fn after(&self, rollouts: usize) -> Moment {
        let known = self.0.range(..=rollouts).next_back();
        known.map_or(START, |(_, &moment)| moment)
    }
}

/// The rows of a table that are whole.
struct Rows {
    names: StringRecord,
    /// Columns in which there are several numbers in a cell.
    lists: BTreeSet<String>,
    rows: Vec<StringRecord>,
}

impl Rows {
    fn read(path: &Path) -> Result<Self, RunError> {
        let text = if_there(path)?.unwrap_or_default();
        // a row that is being written ends without a line feed
        let end = text.iter().rposition(|&byte| byte == b'\n');
        let whole = &text[..end.map_or(0, |end| end + 1)];
        let mut reader = ReaderBuilder::new().flexible(true).from_reader(whole);
        let wrong = |error| RunError::read(path, error);
        let names = reader.headers().map_err(wrong)?.clone();
        let rows = reader.records().collect::<Result<Vec<_>, _>>();
        let mut rows = rows.map_err(wrong)?;
        rows.retain(|row| row.len() == names.len());
        let cells = rows.iter().flat_map(|row| names.iter().zip(row));
        let lists = cells.filter(|(_, cell)| cell.contains(';'));
        let lists = lists.map(|(name, _)| name.to_owned());
        let lists = lists.chain(per_policy_columns().map(str::to_owned));
        let lists = lists.collect();
        Ok(Self { names, lists, rows })
    }

    /// A cell, or nothing where there is no such column.
    fn cell<'a>(&self, row: &'a StringRecord, name: &str) -> &'a str {
        let column = self.names.iter().position(|column| column == name);
        column.and_then(|column| row.get(column)).unwrap_or("")
    }

    /// How many rollouts there are with that of a row, which are counted from 0.
    fn rollouts(&self, row: &StringRecord) -> usize {
        let rollout = self.cell(row, "rollout").parse::<usize>();
        rollout.map_or(0, |rollout| rollout.saturating_add(1))
    }

    /// The cells of a row with their names, but for those that say when it was.
    fn figures<'a>(&'a self, row: &'a StringRecord) -> impl Iterator<Item = (&'a str, &'a str)> {
        let cells = self.names.iter().zip(row);
        cells.filter(|(name, _)| !MOMENTS.contains(name))
    }
}

/// The bytes of a file that not every run has.
fn if_there(path: &Path) -> Result<Option<Vec<u8>>, RunError> {
    match fs::read(path) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(RunError::read(path, error)),
    }
}
