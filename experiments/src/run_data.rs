//! The files of one run's folder.

use std::collections::HashMap;
use std::io::ErrorKind;
use std::path::Path;

use serde::de::DeserializeOwned;
use symmetry::D2;

use crate::error::RunError;
use crate::evaluation::SHOWN;
use crate::experiment::Experiment;
use crate::folder::RunFolder;
use crate::printable::printable;
use crate::provenance::Provenance;
use crate::scoring::looks;
use itertools::Itertools;

use crate::ledger::Ledger;
use crate::schema::{RecognitionRow, RolloutRow, ScoreRow, TimingRow, UnitsRow};

/// Signs of a commit's name that tell it from others.
const SHORT: usize = 10;
/// No run counts so far; sums of what is below do not overflow.
const TOO_MANY: usize = 1 << 32;

/// One run, as its folder tells it.
#[derive(Clone, Debug)]
pub struct RunData {
    /// The folder's name.
    pub name: String,
    /// The processes that worked on the run, the first one first; empty where none is known.
    pub provenance: Vec<Provenance>,
    /// The settings.
    pub experiment: Experiment,
    /// One row a rollout.
    pub rollouts: Vec<RolloutRow>,
    /// Seconds of the rollouts whose seconds are known.
    pub timings: Vec<TimingRow>,
    /// One row a variant and evaluation, in the order in which they were scored.
    pub scores: Vec<ScoreRow>,
    /// One row a policy and evaluation; none of a run that did not look at units.
    pub units: Vec<UnitsRow>,
    /// One row an answer; none of a run that did not ask.
    pub recognition: Vec<RecognitionRow>,
    /// Films of its policies; none unless they were asked for.
    pub films: Vec<GroupFilm>,
}

/// A film of the four variants of a group, each played by the policy that the learner chose.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GroupFilm {
    /// The group's name.
    pub group: String,
    /// A GIF file.
    pub gif: Vec<u8>,
}

impl RunData {
    /// A run without rows.
    pub fn empty(name: &str, experiment: Experiment) -> Self {
        Self {
            name: name.to_owned(),
            provenance: Vec::new(),
            experiment,
            rollouts: Vec::new(),
            timings: Vec::new(),
            scores: Vec::new(),
            units: Vec::new(),
            recognition: Vec::new(),
            films: Vec::new(),
        }
    }

    /// Reads a run's folder.
    ///
    /// # Errors
    /// [`RunError::Read`] names the file and what is wrong in it; [`RunError::UnfitRun`] for
    /// a run that is not finished, and for files that do not belong together.
    pub fn read(path: &Path) -> Result<Self, RunError> {
        let folder = RunFolder::open(path);
        if folder.is_finished() {
            folder.verify_tables()?;
        }
        let scores: Vec<ScoreRow> = rows(&folder.file("evaluation.csv"))?;
        let rollouts: Vec<RolloutRow> = rows(&folder.file("metrics.csv"))?;
        check(path, &folder, &rollouts, &scores)?;
        let units: Vec<UnitsRow> = rows_if_there(&folder.file("units.csv"))?.unwrap_or_default();
        check_units(path, &units, rollouts.len())?;
        let experiment = folder.experiment()?;
        let recognition: Option<Vec<RecognitionRow>> =
            rows_if_there(&folder.file("recognition.csv"))?;
        if let Some(answers) = &recognition {
            check_recognition(path, answers, &scores, looks(&experiment))?;
        }
        let timings: Vec<TimingRow> =
            rows_if_there(&folder.file("timings.csv"))?.unwrap_or_default();
        if !timings.iter().all(TimingRow::is_sound) {
            return Err(unfit(path, "timings.csv holds a row that cannot be"));
        }
        let provenance = match path.join(Provenance::FILE).exists() {
            true => Provenance::read(path)?,
            false => Vec::new(),
        };
        Ok(Self {
            name: name_of(path)?,
            provenance,
            experiment,
            rollouts,
            timings,
            scores,
            units,
            recognition: recognition.unwrap_or_default(),
            films: Vec::new(),
        })
    }

    /// Reads the folder of a run that may go on meanwhile: the rows that are whole.
    ///
    /// # Errors
    /// [`RunError::NoRun`], [`RunError::Read`], and [`RunError::UnfitRun`] for a policy
    /// that cannot have been opened yet.
    pub fn so_far(path: &Path) -> Result<Self, RunError> {
        let folder = RunFolder::open(path);
        let name = name_of(path)?;
        let experiment = folder.experiment()?;
        let rollouts: Vec<RolloutRow> = whole_rows(&folder.file("metrics.csv"))?;
        let mut turns = rollouts.iter().enumerate();
        if turns.any(|(turn, row)| row.policy > turn) {
            return Err(unfit(path, "metrics.csv holds a row that cannot be"));
        }
        Ok(Self {
            rollouts,
            timings: whole_rows(&folder.file("timings.csv"))?,
            scores: whole_rows(&folder.file("evaluation.csv"))?,
            ..Self::empty(&name, experiment)
        })
    }

    /// The group that a policy was opened for: that of its first rollout of one group alone.
    pub fn group_of(&self, policy: usize) -> Option<&str> {
        let mut own = self.rollouts.iter().filter(|row| row.policy == policy);
        Some(&own.find(|row| !row.straddles)?.group)
    }

    /// What each distance of a rollout is held to: the grouping's own threshold, or the largest
    /// distance of the permutations, which is that of chance. Nothing where a grouping permutes
    /// scores of several sources.
    pub fn thresholds(&self, row: &RolloutRow) -> Vec<Option<f64>> {
        let learner = &self.experiment.learner;
        match learner.fixed_threshold() {
            Some(threshold) => vec![Some(threshold); row.distances.len()],
            None if learner.permutes_distances() => row.null_maxima.clone(),
            None => vec![None; row.distances.len()],
        }
    }

    /// Seconds of learning, where those of every rollout are known.
    pub fn seconds(&self) -> Option<f64> {
        let all = self.timings.len() == self.rollouts.len();
        all.then(|| self.timings.iter().fold(0.0, |sum, row| sum + row.total))
    }

    /// The commits that the run was made by, each once, those of changed trees marked.
    pub fn commits(&self) -> Vec<String> {
        let commits = self.provenance.iter().map(|process| {
            let commit = process.commit.as_deref().unwrap_or("unknown");
            let commit: String = printable(commit).chars().take(SHORT).collect();
            let mark = if process.clean == Some(false) { " (changed)" } else { "" };
            format!("{commit}{mark}")
        });
        commits.unique().collect()
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

    /// Decisions before the evaluation after so many rollouts, and the mean of a figure over the
    /// episodes of a group's variants in it; nothing where the group was not scored then.
    pub fn scored(
        &self,
        rollouts: usize,
        group: &str,
        figure: fn(&ScoreRow) -> f64,
    ) -> Option<(usize, f64)> {
        let rows = self.evaluation(Some(rollouts));
        let rows: Vec<&ScoreRow> = rows.filter(|row| row.group == group).collect();
        let sum: f64 = rows.iter().map(|row| figure(row) * row.episodes as f64).sum();
        let episodes: usize = rows.iter().map(|row| row.episodes).sum();
        (episodes > 0).then(|| (rows[0].decisions, sum / episodes as f64))
    }

    /// After how many rollouts evaluations came.
    pub fn evaluated(&self) -> impl Iterator<Item = usize> {
        let mut moments: Vec<usize> = self.scores.iter().map(|row| row.rollouts).collect();
        moments.dedup();
        moments.into_iter()
    }

    /// The groups, in the order in which they are scored.
    pub fn groups(&self) -> Vec<&str> {
        self.last_scores().map(|row| row.group.as_str()).unique().collect()
    }
}

/// Refuses a run that is not at its end, and files that do not belong together.
fn check(
    path: &Path,
    folder: &RunFolder,
    rollouts: &[RolloutRow],
    scores: &[ScoreRow],
) -> Result<(), RunError> {
    let unfit = |problem| unfit(path, problem);
    if !folder.is_finished() {
        return Err(unfit("it is not finished; go on with `covers resume`"));
    }
    let share = |value: f64| (0.0..=1.0).contains(&value);
    let elements = D2::ALL.map(|element| element.to_string());
    let sound = |row: &ScoreRow| {
        counted(row.episodes)
            && elements.contains(&row.element)
            && share(row.success)
            && share(row.success_at_end)
            && row.reward.is_finite()
            && row.own_success.into_iter().chain(row.own_success_at_end).all(share)
            && row.own_reward.is_none_or(f64::is_finite)
            && [row.own_success, row.own_success_at_end, row.own_reward]
                .iter()
                .all(|own| own.is_some() == row.own_policy.is_some())
    };
    if !scores.iter().all(sound) {
        return Err(unfit("evaluation.csv holds a score that cannot be"));
    }
    let numbers = |row: &RolloutRow| {
        let distances = row.distances.iter().chain(&row.null_maxima);
        let distances = distances.copied().flatten();
        let own = row.reward.into_iter().chain(row.success).chain(distances);
        own.collect::<Vec<f64>>()
    };
    let mut turns = rollouts.iter().enumerate();
    if !rollouts.is_sorted_by_key(|row| row.decisions)
        || turns
            .any(|(turn, row)| row.policy > turn || !numbers(row).into_iter().all(f64::is_finite))
    {
        return Err(unfit("metrics.csv holds a row that cannot be"));
    }
    let in_order = scores.is_sorted_by_key(|row| row.rollouts);
    if !in_order || scores.last().map(|row| row.rollouts) != Some(rollouts.len()) {
        return Err(unfit("the last rows of evaluation.csv and metrics.csv do not agree"));
    }
    if !scores.iter().all(|row| spent(rollouts, row.rollouts) == Some(row.decisions)) {
        return Err(unfit("evaluation.csv and metrics.csv do not agree about decisions"));
    }
    let variants = scores.iter();
    if !variants.map(|row| (row.rollouts, &row.group, &row.element)).all_unique() {
        return Err(unfit("evaluation.csv scores a variant twice at a time"));
    }
    check_own_policies(path, rollouts, scores)
}

/// Refuses scores of a policy that was not the group's own when they were made. Older runs did not
/// record such scores.
fn check_own_policies(
    path: &Path,
    rollouts: &[RolloutRow],
    scores: &[ScoreRow],
) -> Result<(), RunError> {
    for evaluation in scores.chunk_by(|one, other| one.rollouts == other.rollouts) {
        let own = Ledger::of(&rollouts[..evaluation[0].rollouts]).own_policies();
        let is_sound = |row: &ScoreRow| {
            row.own_policy.is_none() || row.own_policy == own.get(&row.group).copied()
        };
        if !evaluation.iter().all(is_sound) {
            return Err(unfit(
                path,
                "evaluation.csv and metrics.csv do not agree about the groups' own policies",
            ));
        }
    }
    Ok(())
}

/// Decisions taken by the end of the first so many rollouts; none where there are fewer.
fn spent(rollouts: &[RolloutRow], first: usize) -> Option<usize> {
    match first.checked_sub(1) {
        None => Some(0),
        Some(last) => rollouts.get(last).map(|row| row.decisions),
    }
}

fn check_units(path: &Path, units: &[UnitsRow], rollouts: usize) -> Result<(), RunError> {
    let sound = |row: &UnitsRow| counted(row.units) && row.dormant <= row.units;
    if !units.iter().all(sound) {
        return Err(unfit(path, "units.csv holds a row that cannot be"));
    }
    if !units.iter().map(|row| (row.rollouts, row.policy)).all_unique() {
        return Err(unfit(path, "units.csv counts a policy twice at a time"));
    }
    match units.last() {
        Some(last) if last.rollouts != rollouts => {
            Err(unfit(path, "the last rows of units.csv and metrics.csv do not agree"))
        }
        _ => Ok(()),
    }
}

/// Refuses answers that are no run's: a learner is asked as often about each variant that is scored,
/// with each number of episodes.
fn check_recognition(
    path: &Path,
    answers: &[RecognitionRow],
    scores: &[ScoreRow],
    looks: usize,
) -> Result<(), RunError> {
    let scored = |group: &str| scores.iter().any(|row| row.group == group);
    let sound = |row: &RecognitionRow| {
        counted(row.times) && SHOWN.contains(&row.episodes) && scored(&row.group)
    };
    if !answers.iter().all(sound) {
        return Err(unfit(path, "recognition.csv holds a row that cannot be"));
    }
    let keys = answers.iter();
    if !keys.map(|row| (&row.group, &row.element, row.episodes, row.policy)).all_unique() {
        return Err(unfit(path, "recognition.csv counts an answer twice"));
    }
    let mut times: HashMap<(&str, &str, usize), usize> = HashMap::new();
    for row in answers {
        *times.entry((&row.group, &row.element, row.episodes)).or_default() += row.times;
    }
    let last = scores.last().map(|row| row.rollouts);
    let variants = scores.iter().filter(|row| Some(row.rollouts) == last);
    let mut expected = 0;
    for (row, episodes) in variants.flat_map(|row| SHOWN.map(|episodes| (row, episodes))) {
        let asked = times.get(&(row.group.as_str(), row.element.as_str(), episodes));
        let asked = asked.copied().unwrap_or(0);
        if asked != looks {
            let (group, element) = (&row.group, &row.element);
            let problem = format!(
                "recognition.csv holds {asked} answers to {episodes} episodes of {group}, {element}, \
                 expected {looks} as `evaluation.looks` has it: the file is incomplete or changed"
            );
            return Err(unfit(path, &problem));
        }
        expected += looks;
    }
    if times.values().sum::<usize>() != expected {
        let problem = "recognition.csv holds answers to variants that were not scored at the end";
        return Err(unfit(path, problem));
    }
    Ok(())
}

/// Whether something that was counted can have been so many.
fn counted(count: usize) -> bool {
    (1..TOO_MANY).contains(&count)
}

fn unfit(folder: &Path, problem: &str) -> RunError {
    RunError::UnfitRun { folder: folder.to_owned(), problem: problem.to_owned() }
}

/// The last part of a path, also of `.`.
fn name_of(path: &Path) -> Result<String, RunError> {
    let whole = path.canonicalize();
    let whole = whole.map_err(|error| RunError::read(path, error))?;
    let name = whole.file_name().unwrap_or(whole.as_os_str());
    Ok(printable(&name.to_string_lossy()))
}

/// The rows of a table that is whole.
fn rows<R: DeserializeOwned>(path: &Path) -> Result<Vec<R>, RunError> {
    let text = std::fs::read(path).map_err(|error| RunError::read(path, error))?;
    // a cell that was cut short would pass for another number
    if text.last().is_some_and(|&last| last != b'\n') {
        let problem = "the last row has no line end, as every row of a whole table has: the file \
            was cut off: restore it, or resume the run if its checkpoints are there";
        return Err(RunError::damaged(path, problem.to_owned()));
    }
    let rows = csv::Reader::from_reader(&text[..]).into_deserialize();
    let rows = rows.collect::<Result<_, _>>();
    rows.map_err(|error| RunError::read(path, error))
}

/// The rows of a file that not every run has; nothing where there is no file.
fn rows_if_there<R: DeserializeOwned>(path: &Path) -> Result<Option<Vec<R>>, RunError> {
    path.exists().then(|| rows(path)).transpose()
}

/// The rows of a file that somebody may be writing to: the last one counts once its line is ended.
fn whole_rows<R: DeserializeOwned>(path: &Path) -> Result<Vec<R>, RunError> {
    let text = match std::fs::read(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Vec::new(),
        read => read.map_err(|error| RunError::read(path, error))?,
    };
    let end = text.iter().rposition(|&byte| byte == b'\n');
    let whole = &text[..end.map_or(0, |end| end + 1)];
    let rows = csv::Reader::from_reader(whole).into_deserialize();
    let rows = rows.collect::<Result<_, _>>();
    rows.map_err(|error| RunError::read(path, error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::presets::{Budget, Method};

    #[test]
    fn a_run_has_seconds_where_every_rollout_has() {
        let mut run = RunData::empty("run", Budget::Smoke.experiment(Method::Covers));
        assert_eq!(run.seconds(), Some(0.0));
        // of a process after a crash that took the table with it
        run.timings = vec![TimingRow::default()];
        assert_eq!(run.seconds(), None);
    }

    /// Whoever sorts a table by variants leaves a group's rows apart.
    #[test]
    fn a_group_is_named_once_wherever_its_rows_are() {
        let mut run = RunData::empty("run", Budget::Smoke.experiment(Method::Covers));
        let row = |group: &str| ScoreRow {
            rollouts: 1,
            decisions: 500,
            group: group.to_owned(),
            element: D2::Identity.to_string(),
            seen: true,
            episodes: 1,
            success: 0.5,
            success_at_end: 0.5,
            reward: 100.0,
            ..ScoreRow::default()
        };
        run.scores = ["b", "a", "b"].map(row).to_vec();
        assert_eq!(run.groups(), ["b", "a"]);
    }

    #[test]
    fn distances_are_held_to_chance_or_to_the_threshold_of_the_paper() {
        let mut run = RunData::empty("run", Budget::Smoke.experiment(Method::Covers));
        let row = RolloutRow {
            distances: vec![Some(0.5), None],
            null_maxima: vec![Some(0.25), None],
            ..RolloutRow::default()
        };
        assert_eq!(run.thresholds(&row), [Some(0.25), None]);
        run.experiment.learner = Method::Paper.learner();
        assert_eq!(run.thresholds(&row), [Some(1.0), Some(1.0)]);
    }
}
