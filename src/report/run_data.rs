//! The files of one run's folder.

use std::path::Path;

use serde::de::{DeserializeOwned, Error as _};
use serde::{Deserialize, Deserializer};

use crate::error::CoversError;
use crate::evaluation::SHOWN;
use crate::experiment::Experiment;
use crate::runs::{Provenance, RunFolder};

/// Signs of a commit's name that tell it from others.
const SHORT: usize = 10;
/// No run counts so far; sums of what is below do not overflow.
const TOO_MANY: usize = 1 << 32;

/// One run, as its folder tells it.
#[derive(Clone, Debug)]
pub struct RunData {
    /// The folder's name.
    pub name: String,
    /// Commits that worked on the run, the first one first; empty where none is known.
    pub commits: Vec<String>,
    /// The settings.
    pub experiment: Experiment,
    /// One row a rollout.
    pub rollouts: Vec<RolloutRow>,
    /// Seconds of learning of the rollouts whose seconds are known.
    pub seconds: f64,
    /// One row a variant and evaluation, in the order in which they were scored.
    pub scores: Vec<ScoreRow>,
    /// One row a policy and evaluation; none of a run that did not look at units.
    pub units: Vec<UnitsRow>,
    /// One row an answer; none of a run that did not ask.
    pub recognition: Vec<RecognitionRow>,
}

/// A row of `metrics.csv`, without what a learner adds of its own.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct RolloutRow {
    /// Decisions taken by the end of the rollout.
    pub decisions: usize,
    /// The group that ran when the turn began.
    pub group: String,
    /// The group that ran when it ended.
    pub last_group: String,
    /// Whether the group changed within the turn.
    pub straddles: bool,
    /// The policy that learnt.
    pub policy: usize,
    /// Mean return on the paper's scale, in `[0, 500]`; none where no episode ended.
    pub reward: Option<f64>,
    /// Share of episodes that succeeded, in `[0, 1]`; none where none ended.
    pub success: Option<f64>,
    /// For each policy the one that acts for its group since the two were merged; empty where the
    /// learner merges none.
    #[serde(default, deserialize_with = "heirs")]
    pub heirs: Vec<Option<usize>>,
}

/// Numbers with semicolons between them, some of which are missing.
fn heirs<'de, D: Deserializer<'de>>(cell: D) -> Result<Vec<Option<usize>>, D::Error> {
    let cell = String::deserialize(cell)?;
    let number = |word: &str| match word {
        "" => Ok(None),
        word => word.parse().map(Some),
    };
    let heirs = cell.split(';').map(number).collect::<Result<_, _>>();
    heirs.map_err(|error| D::Error::custom(format!("heirs `{cell}`: {error}")))
}

/// A row of `evaluation.csv`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct ScoreRow {
    /// Rollouts learnt from before the evaluation.
    pub rollouts: usize,
    /// Decisions taken before the evaluation.
    pub decisions: usize,
    /// The variant's group.
    pub group: String,
    /// The variant's element of D2, as it is spelt.
    pub element: String,
    /// Whether the learner meets the variant while it learns.
    pub seen: bool,
    /// Episodes played.
    pub episodes: usize,
    /// As in [`Score`](crate::evaluation::Score).
    pub success: f64,
    /// As there.
    pub success_at_end: f64,
    /// As there.
    pub reward: f64,
}

/// A row of `units.csv`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct UnitsRow {
    /// Rollouts learnt from before the evaluation.
    pub rollouts: usize,
    /// The policy.
    pub policy: usize,
    /// Rectified units of its network.
    pub units: usize,
    /// Those that are dormant.
    pub dormant: usize,
}

/// A row of `recognition.csv`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct RecognitionRow {
    /// The group that was shown.
    pub group: String,
    /// Episodes that were shown each time.
    pub episodes: usize,
    /// The policy that was named; none where none of them was.
    pub policy: Option<usize>,
    /// How often.
    pub times: usize,
}

#[derive(Deserialize)]
struct TimingRow {
    total: f64,
}

impl RunData {
    /// Reads a run's folder.
    ///
    /// # Errors
    /// [`CoversError::Read`] names the file and what is wrong in it; [`CoversError::UnfitRun`] for
    /// a run that is not finished, and for files that do not belong together.
    pub fn read(path: &Path) -> Result<Self, CoversError> {
        let folder = RunFolder::open(path);
        let scores: Vec<ScoreRow> = rows(&folder.file("evaluation.csv"))?;
        let rollouts: Vec<RolloutRow> = rows(&folder.file("metrics.csv"))?;
        check(path, &folder, &rollouts, &scores)?;
        let units: Vec<UnitsRow> = rows_if_there(&folder.file("units.csv"))?;
        check_units(path, &units, rollouts.len())?;
        let recognition: Vec<RecognitionRow> = rows_if_there(&folder.file("recognition.csv"))?;
        check_recognition(path, &recognition, &scores)?;
        let timings: Vec<TimingRow> = rows_if_there(&folder.file("timings.csv"))?;
        Ok(Self {
            name: name_of(path)?,
            commits: commits(path)?,
            experiment: folder.experiment()?,
            rollouts,
            seconds: timings.iter().map(|row| row.total).sum(),
            scores,
            units,
            recognition,
        })
    }

    /// The rows of the evaluation after the stream.
    pub fn last_scores(&self) -> impl Iterator<Item = &ScoreRow> {
        let last = self.scores.last().map(|row| row.rollouts);
        self.evaluation(last)
    }

    /// The rows of the evaluation after this many rollouts.
    pub fn evaluation(&self, rollouts: Option<usize>) -> impl Iterator<Item = &ScoreRow> {
        let rows = self.scores.iter();
        rows.filter(move |row| Some(row.rollouts) == rollouts)
    }

    /// After how many rollouts evaluations came.
    pub fn evaluated(&self) -> impl Iterator<Item = usize> {
        let mut moments: Vec<usize> = self.scores.iter().map(|row| row.rollouts).collect();
        moments.dedup();
        moments.into_iter()
    }

    /// The groups, in the order in which they are scored.
    pub fn groups(&self) -> Vec<&str> {
        let mut groups: Vec<&str> = self.last_scores().map(|row| row.group.as_str()).collect();
        groups.dedup();
        groups
    }
}

/// Refuses a run that is not at its end, and files that do not belong together.
fn check(
    path: &Path,
    folder: &RunFolder,
    rollouts: &[RolloutRow],
    scores: &[ScoreRow],
) -> Result<(), CoversError> {
    let unfit = |problem| unfit(path, problem);
    if !folder.is_finished() {
        return Err(unfit("it is not finished; go on with `covers resume`"));
    }
    let share = |value: f64| (0.0..=1.0).contains(&value);
    let sound = |row: &ScoreRow| {
        counted(row.episodes)
            && share(row.success)
            && share(row.success_at_end)
            && row.reward.is_finite()
    };
    if !scores.iter().all(sound) {
        return Err(unfit("evaluation.csv holds a score that cannot be"));
    }
    let numbers = |row: &RolloutRow| row.reward.into_iter().chain(row.success);
    let mut turns = rollouts.iter().enumerate();
    if !rollouts.is_sorted_by_key(|row| row.decisions)
        || turns.any(|(turn, row)| row.policy > turn || !numbers(row).all(f64::is_finite))
    {
        return Err(unfit("metrics.csv holds a row that cannot be"));
    }
    let end = rollouts.last().map(|row| (rollouts.len(), row.decisions));
    let in_order = scores.is_sorted_by_key(|row| row.rollouts);
    if !in_order || scores.last().map(|row| (row.rollouts, row.decisions)) != end {
        return Err(unfit(
            "the last rows of evaluation.csv and metrics.csv do not agree",
        ));
    }
    Ok(())
}

fn check_units(path: &Path, units: &[UnitsRow], rollouts: usize) -> Result<(), CoversError> {
    let sound = |row: &UnitsRow| counted(row.units) && row.dormant <= row.units;
    if !units.iter().all(sound) {
        return Err(unfit(path, "units.csv holds a row that cannot be"));
    }
    match units.last() {
        Some(last) if last.rollouts != rollouts => Err(unfit(
            path,
            "the last rows of units.csv and metrics.csv do not agree",
        )),
        _ => Ok(()),
    }
}

fn check_recognition(
    path: &Path,
    answers: &[RecognitionRow],
    scores: &[ScoreRow],
) -> Result<(), CoversError> {
    let scored = |group: &str| scores.iter().any(|row| row.group == group);
    let sound = |row: &RecognitionRow| {
        counted(row.times) && SHOWN.contains(&row.episodes) && scored(&row.group)
    };
    match answers.iter().all(sound) {
        true => Ok(()),
        false => Err(unfit(path, "recognition.csv holds a row that cannot be")),
    }
}

/// Whether something that was counted can have been so many.
fn counted(count: usize) -> bool {
    (1..TOO_MANY).contains(&count)
}

fn unfit(folder: &Path, problem: &str) -> CoversError {
    CoversError::UnfitRun {
        folder: folder.to_owned(),
        problem: problem.to_owned(),
    }
}

/// The last part of a path, also of `.`.
fn name_of(path: &Path) -> Result<String, CoversError> {
    let whole = path.canonicalize();
    let whole = whole.map_err(|error| CoversError::read(path, error))?;
    let name = whole.file_name().unwrap_or(whole.as_os_str());
    Ok(name.to_string_lossy().into_owned())
}

fn rows<R: DeserializeOwned>(path: &Path) -> Result<Vec<R>, CoversError> {
    let reader = csv::Reader::from_path(path);
    let mut reader = reader.map_err(|error| CoversError::read(path, error))?;
    let rows = reader.deserialize().collect::<Result<_, _>>();
    rows.map_err(|error| CoversError::read(path, error))
}

/// The rows of a file that not every run has.
fn rows_if_there<R: DeserializeOwned>(path: &Path) -> Result<Vec<R>, CoversError> {
    match path.exists() {
        true => rows(path),
        false => Ok(Vec::new()),
    }
}

/// The commits that a run was made by, each once, those of changed trees marked.
fn commits(folder: &Path) -> Result<Vec<String>, CoversError> {
    if !folder.join(Provenance::FILE).exists() {
        return Ok(Vec::new());
    }
    let mut commits = Vec::new();
    for process in Provenance::read(folder)? {
        let commit = process.commit.unwrap_or_else(|| "unknown".to_owned());
        let commit: String = commit.chars().take(SHORT).collect();
        let mark = if process.clean == Some(false) {
            " (changed)"
        } else {
            ""
        };
        let commit = format!("{commit}{mark}");
        if !commits.contains(&commit) {
            commits.push(commit);
        }
    }
    Ok(commits)
}
