//! Files of a run's folder, read and checked for reports and viewers.

use std::collections::HashMap;
use std::io::ErrorKind;
use std::path::Path;

use learner::GroupingSettings;
use serde::de::DeserializeOwned;
use symmetry::D2;

use crate::error::RunError;
use crate::evaluation::RECOGNITION_EPISODE_COUNTS;
use crate::experiment::Experiment;
use crate::folder::{RunFolder, file_exists};
use crate::printable::escape_unprintable;
use crate::provenance::Provenance;
use crate::scoring::recognition_repeats;
use itertools::Itertools;

use crate::run_stats::RunStats;
use crate::schema::{DormantUnitsRow, RecognitionRow, RolloutRow, ScoreRow, TimingRow};

/// Number of characters of an abbreviated commit hash.
const COMMIT_LENGTH: usize = 10;
/// Exclusive upper bound of counts in a run's tables. No run reaches it, and sums of smaller counts
/// do not overflow.
const TOO_MANY: usize = 1 << 32;

/// Settings and tables of one run, as read from its folder.
#[derive(Clone, Debug)]
pub struct RunData {
    /// Name of the run's folder.
    pub name: String,
    /// `true` if the run reached the end of its stream.
    pub is_finished: bool,
    /// Records of the processes that worked on the run, oldest first; empty if unknown.
    pub provenance: Vec<Provenance>,
    /// Settings of the run.
    pub experiment: Experiment,
    /// Rows of `metrics.csv`, one per rollout.
    pub rollouts: Vec<RolloutRow>,
    /// Rows of `timings.csv`, for the rollouts with known seconds.
    pub timings: Vec<TimingRow>,
    /// Rows of `evaluation.csv`, one per variant and evaluation, in the order of scoring.
    pub scores: Vec<ScoreRow>,
    /// Rows of `units.csv`, one per policy and evaluation; empty for runs of older versions.
    pub dormant_units: Vec<DormantUnitsRow>,
    /// Rows of `recognition.csv`, one per answer; empty if the learner was not asked.
    pub recognitions: Vec<RecognitionRow>,
    /// Films of the run's policies; empty unless requested.
    pub films: Vec<GroupFilm>,
}

/// Film of the four variants of a task group, each played by the policy that the learner chose.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GroupFilm {
    /// Name of the task group.
    pub group: String,
    /// Bytes of the film as a GIF file.
    pub gif: Vec<u8>,
}

impl RunData {
    /// Returns the data of a run that counts as finished, without rows in its tables, provenance
    /// and films.
    pub fn empty(name: &str, experiment: Experiment) -> Self {
        Self {
            name: name.to_owned(),
            is_finished: true,
            provenance: Vec::new(),
            experiment,
            rollouts: Vec::new(),
            timings: Vec::new(),
            scores: Vec::new(),
            dormant_units: Vec::new(),
            recognitions: Vec::new(),
            films: Vec::new(),
        }
    }

    /// Reads and checks the folder of a finished run.
    ///
    /// # Errors
    /// [`RunError::Read`] with the file and the problem; [`RunError::ChangedTable`];
    /// [`RunError::UnreportableRun`] for an unfinished run and for tables that contradict each
    /// other.
    pub fn read(path: &Path) -> Result<Self, RunError> {
        let folder = RunFolder::from_path(path);
        if folder.is_finished() {
            folder.verify_table_checksums()?;
        }
        let scores: Vec<ScoreRow> = rows(&folder.file_path("evaluation.csv"))?;
        let rollouts: Vec<RolloutRow> = rows(&folder.file_path("metrics.csv"))?;
        if !folder.is_finished() {
            return Err(unfit(path, "it is not finished; continue it with `covers resume`"));
        }
        check(path, &rollouts, &scores)?;
        if scores.last().map(|row| row.rollouts) != Some(rollouts.len()) {
            return Err(unfit(path, DISAGREE));
        }
        let units: Vec<DormantUnitsRow> =
            rows_if_there(&folder.file_path("units.csv"))?.unwrap_or_default();
        check_units(path, &units, rollouts.len())?;
        let experiment = folder.read_experiment()?;
        let recognition: Option<Vec<RecognitionRow>> =
            rows_if_there(&folder.file_path("recognition.csv"))?;
        if let Some(answers) = &recognition {
            check_recognition(path, answers, &scores, recognition_repeats(&experiment))?;
        }
        let timings: Vec<TimingRow> =
            rows_if_there(&folder.file_path("timings.csv"))?.unwrap_or_default();
        if !timings.iter().all(TimingRow::is_valid) {
            let problem =
                "timings.csv holds a row that cannot be: seconds must be finite and not negative";
            return Err(unfit(path, problem));
        }
        let provenance = Provenance::read(path)?;
        Ok(Self {
            name: name_of(path)?,
            is_finished: true,
            provenance,
            experiment,
            rollouts,
            timings,
            scores,
            dormant_units: units,
            recognitions: recognition.unwrap_or_default(),
            films: Vec::new(),
        })
    }

    /// Reads the settings of a run that may be in progress, and its complete rows on rollouts,
    /// seconds and scores. Evaluations whose rollouts are not all in `metrics.csv` are left out.
    ///
    /// # Errors
    /// [`RunError::NoRun`], [`RunError::Read`], and [`RunError::UnreportableRun`] for tables that
    /// contradict each other, or with values that no run has.
    pub fn read_partial(path: &Path) -> Result<Self, RunError> {
        let folder = RunFolder::from_path(path);
        let experiment = folder.read_experiment()?;
        let name = name_of(path)?;
        let rollouts: Vec<RolloutRow> = whole_rows(&folder.file_path("metrics.csv"))?;
        let mut scores: Vec<ScoreRow> = whole_rows(&folder.file_path("evaluation.csv"))?;
        // a run that goes on may have written to it since, and after a power cut it may be ahead
        scores.retain(|row| row.rollouts <= rollouts.len());
        check(path, &rollouts, &scores)?;
        Ok(Self {
            is_finished: folder.is_finished(),
            provenance: Provenance::read(path)?,
            rollouts,
            timings: whole_rows(&folder.file_path("timings.csv"))?,
            scores,
            ..Self::empty(&name, experiment)
        })
    }

    /// Returns the number of policies that were trained so far, merged ones included: one more than
    /// the largest index of a policy in [`RunData::rollouts`], and 0 without rollouts.
    pub fn policy_count(&self) -> usize {
        self.rollouts.iter().map(|row| row.policy + 1).max().unwrap_or(0)
    }

    /// Returns the name of the task group that a policy was created for: the group of its first
    /// rollout without a task switch. `None` without such a rollout.
    pub fn group_of_policy(&self, policy: usize) -> Option<&str> {
        let mut own = self.rollouts.iter().filter(|row| row.policy == policy);
        Some(&own.find(|row| !row.spans_switch)?.group)
    }

    /// Returns, for each policy that the rollout `row` was compared with, the threshold of its
    /// distance: the grouping's fixed one, or the largest distance under permutation, which chance
    /// alone can reach. Items are `None` for groupings that permute other scores than distances.
    pub fn policy_distance_thresholds(&self, row: &RolloutRow) -> Vec<Option<f64>> {
        match self.experiment.learner.grouping() {
            GroupingSettings::Threshold { threshold } => vec![Some(threshold); row.distances.len()],
            GroupingSettings::Evidence(_) => vec![None; row.distances.len()],
            _ => row.permutation_maxima.clone(),
        }
    }

    /// Returns the wall-clock seconds of training; `None` unless those of every rollout are known.
    pub fn training_seconds(&self) -> Option<f64> {
        let all = self.timings.len() == self.rollouts.len();
        all.then(|| self.timings.iter().fold(0.0, |sum, row| sum + row.total))
    }

    /// Returns the distinct Git commits that the run was made with, ten digits or `unknown` each;
    /// `(changed)` marks local changes.
    pub fn git_commits(&self) -> Vec<String> {
        let commits = self.provenance.iter().map(|process| {
            let commit = process.commit.as_deref().unwrap_or("unknown");
            let commit: String = escape_unprintable(commit).chars().take(COMMIT_LENGTH).collect();
            let mark = if process.clean_checkout == Some(false) { " (changed)" } else { "" };
            format!("{commit}{mark}")
        });
        commits.unique().collect()
    }

    /// Returns the scores of all variants in the run's last evaluation.
    pub fn last_scores(&self) -> impl Iterator<Item = &ScoreRow> {
        let last = self.scores.last().map(|row| row.rollouts);
        self.scores_after(last)
    }

    /// Returns the scores of all variants in the evaluation after `rollouts` rollouts; none if
    /// there was no such evaluation.
    pub fn scores_after(&self, rollouts: Option<usize>) -> impl Iterator<Item = &ScoreRow> {
        self.scores.iter().filter(move |row| Some(row.rollouts) == rollouts)
    }

    /// Returns, for the evaluation after `rollouts` rollouts, the number of decisions before it and
    /// the mean of the score `figure` over the episodes of a group; `None` if the group was not
    /// scored then.
    pub fn mean_group_score_after(
        &self,
        rollouts: usize,
        group: &str,
        figure: fn(&ScoreRow) -> f64,
    ) -> Option<(usize, f64)> {
        let rows = self.scores_after(Some(rollouts));
        let rows: Vec<&ScoreRow> = rows.filter(|row| row.group == group).collect();
        let sum: f64 = rows.iter().map(|row| figure(row) * row.episodes as f64).sum();
        let episodes: usize = rows.iter().map(|row| row.episodes).sum();
        (episodes > 0).then(|| (rows[0].decisions, sum / episodes as f64))
    }

    /// Returns, for each evaluation of the run, the number of rollouts before it.
    pub fn rollouts_before_evaluations(&self) -> impl Iterator<Item = usize> {
        let mut rollouts: Vec<usize> = self.scores.iter().map(|row| row.rollouts).collect();
        rollouts.dedup();
        rollouts.into_iter()
    }

    /// Returns the names of the task groups in the run's last evaluation, in the order of scoring.
    pub fn scored_groups(&self) -> Vec<&str> {
        self.last_scores().map(|row| row.group.as_str()).unique().collect()
    }
}

/// Problem of tables of which one has more rows than the other.
const DISAGREE: &str = "the last rows of evaluation.csv and metrics.csv do not agree";

/// Rejects tables that contradict each other, and rows that no run writes.
fn check(path: &Path, rollouts: &[RolloutRow], scores: &[ScoreRow]) -> Result<(), RunError> {
    let unfit = |problem| unfit(path, problem);
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
        return Err(unfit(
            "evaluation.csv holds a score that cannot be: it needs episodes, an element of D2, \
             shares in [0, 1], finite returns, and all of the `own_` columns or none",
        ));
    }
    check_rollouts(path, rollouts)?;
    let in_order = scores.is_sorted_by_key(|row| row.rollouts);
    if !in_order || scores.last().is_some_and(|row| row.rollouts > rollouts.len()) {
        return Err(unfit(DISAGREE));
    }
    if !scores.iter().all(|row| spent(rollouts, row.rollouts) == Some(row.decisions)) {
        return Err(unfit("evaluation.csv and metrics.csv do not agree about decisions"));
    }
    if !scores.iter().map(|row| (row.rollouts, &row.group, &row.element)).all_unique() {
        return Err(unfit("evaluation.csv scores a variant twice in one evaluation"));
    }
    check_own_policies(path, rollouts, scores)
}

/// Largest number of policies of a run that is read; it bounds the memory of tables by policy.
const MAX_POLICIES: usize = 10_000;

/// Rejects rows of rollouts with values that no rollout has.
fn check_rollouts(path: &Path, rollouts: &[RolloutRow]) -> Result<(), RunError> {
    let finite = |row: &RolloutRow| {
        let scores = [&row.distances, &row.permutation_maxima, &row.permutation_z_scores];
        let scores = scores.into_iter().flatten().copied().flatten();
        row.reward.into_iter().chain(scores).all(f64::is_finite)
    };
    // a policy is created for at least one decision; rollouts before it may have been discarded
    let exists = |row: &RolloutRow| row.policy <= row.decisions && row.policy < MAX_POLICIES;
    let mut before = 0;
    for (rollout, row) in rollouts.iter().enumerate() {
        let problem = if row.decisions < before {
            "`decisions` is less than before"
        } else if !exists(row) {
            "`policy` is a policy that cannot exist yet"
        } else if !row.success.is_none_or(share) {
            "`success` is not a share in [0, 1]"
        } else if !finite(row) {
            "a reward, distance or score is not finite"
        } else {
            before = row.decisions;
            continue;
        };
        return Err(unfit(path, &format!("metrics.csv, rollout {rollout}: {problem}")));
    }
    Ok(())
}

/// Returns `true` for a number in `[0, 1]`.
fn share(value: f64) -> bool {
    (0.0..=1.0).contains(&value)
}

/// Rejects scores of an own policy that was not the group's own at that time. Runs of older
/// versions have no such scores.
fn check_own_policies(
    path: &Path,
    rollouts: &[RolloutRow],
    scores: &[ScoreRow],
) -> Result<(), RunError> {
    for evaluation in scores.chunk_by(|one, other| one.rollouts == other.rollouts) {
        let own = RunStats::from_rollouts(&rollouts[..evaluation[0].rollouts]).own_policies();
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

/// Returns the number of decisions in the first `first` rollouts; `None` if there are fewer.
fn spent(rollouts: &[RolloutRow], first: usize) -> Option<usize> {
    match first.checked_sub(1) {
        None => Some(0),
        Some(last) => rollouts.get(last).map(|row| row.decisions),
    }
}

fn check_units(path: &Path, units: &[DormantUnitsRow], rollouts: usize) -> Result<(), RunError> {
    let sound =
        |row: &DormantUnitsRow| counted(row.unit_count) && row.dormant_count <= row.unit_count;
    if !units.iter().all(sound) {
        let problem = "units.csv holds a row that cannot be: dormant units must not exceed units";
        return Err(unfit(path, problem));
    }
    if !units.iter().map(|row| (row.rollouts, row.policy)).all_unique() {
        return Err(unfit(path, "units.csv counts a policy twice in one evaluation"));
    }
    match units.last() {
        Some(last) if last.rollouts != rollouts => {
            Err(unfit(path, "the last rows of units.csv and metrics.csv do not agree"))
        }
        _ => Ok(()),
    }
}

/// Rejects rows of `recognition.csv` that no run can have. A learner is asked `repeats` times about
/// each scored variant with each number of episodes.
fn check_recognition(
    path: &Path,
    answers: &[RecognitionRow],
    scores: &[ScoreRow],
    repeats: usize,
) -> Result<(), RunError> {
    let scored = |group: &str| scores.iter().any(|row| row.group == group);
    let sound = |row: &RecognitionRow| {
        counted(row.count)
            && RECOGNITION_EPISODE_COUNTS.contains(&row.episodes_shown)
            && scored(&row.group)
    };
    if !answers.iter().all(sound) {
        let problem = "recognition.csv holds a row that cannot be: it needs a group that was \
            scored, 1, 4 or 20 episodes, and a count of times";
        return Err(unfit(path, problem));
    }
    let unique = answers
        .iter()
        .map(|row| (&row.group, &row.element, row.episodes_shown, row.policy))
        .all_unique();
    if !unique {
        return Err(unfit(path, "recognition.csv counts an answer twice"));
    }
    let mut times: HashMap<(&str, &str, usize), usize> = HashMap::new();
    for row in answers {
        *times.entry((&row.group, &row.element, row.episodes_shown)).or_default() += row.count;
    }
    let last = scores.last().map(|row| row.rollouts);
    let variants = scores.iter().filter(|row| Some(row.rollouts) == last);
    let mut expected = 0;
    for (row, episodes) in
        variants.flat_map(|row| RECOGNITION_EPISODE_COUNTS.map(|episodes| (row, episodes)))
    {
        let asked = times.get(&(row.group.as_str(), row.element.as_str(), episodes));
        let asked = asked.copied().unwrap_or(0);
        if asked != repeats {
            let (group, element) = (&row.group, &row.element);
            let problem = format!(
                "recognition.csv holds {asked} answers to {episodes} episodes of {group}, {element}, \
                 expected {repeats} as `evaluation.looks` has it: the file is incomplete or changed"
            );
            return Err(unfit(path, &problem));
        }
        expected += repeats;
    }
    if times.values().sum::<usize>() != expected {
        let problem = "recognition.csv holds answers to variants that were not scored at the end";
        return Err(unfit(path, problem));
    }
    Ok(())
}

/// Returns `true` if a count read from a table is at least 1 and below [`TOO_MANY`].
fn counted(count: usize) -> bool {
    (1..TOO_MANY).contains(&count)
}

fn unfit(folder: &Path, problem: &str) -> RunError {
    RunError::UnreportableRun { folder: folder.to_owned(), problem: problem.to_owned() }
}

/// Returns the last part of a path, also for `.`.
fn name_of(path: &Path) -> Result<String, RunError> {
    let whole = path.canonicalize().map_err(RunError::read_error_mapper(path))?;
    let name = whole.file_name().unwrap_or(whole.as_os_str());
    Ok(escape_unprintable(&name.to_string_lossy()))
}

/// Reads all rows of a complete table (CSV) of a run.
fn rows<R: DeserializeOwned>(path: &Path) -> Result<Vec<R>, RunError> {
    let text = std::fs::read(path).map_err(RunError::read_error_mapper(path))?;
    // without a line end the last cell may be cut, and pass for another number
    if text.last().is_some_and(|&last| last != b'\n') {
        let problem = "the last row has no line end, as every row of a whole table has: the file \
            was cut off: restore it, or resume the run if its checkpoints are there";
        return Err(RunError::damaged_file(path, problem.to_owned()));
    }
    let rows = csv::Reader::from_reader(&text[..]).into_deserialize();
    rows.collect::<Result<_, _>>().map_err(|error| malformed(path, error))
}

/// Returns the error of a table that cannot be parsed, with the line and the column.
fn malformed(path: &Path, error: csv::Error) -> RunError {
    let csv::ErrorKind::Deserialize { pos, err } = error.kind() else {
        return RunError::cannot_read(path, error);
    };
    let line = pos.as_ref().map_or_else(String::new, |pos| format!("line {}, ", pos.line()));
    let column = err.field().map_or_else(String::new, |field| format!("column {}, ", field + 1));
    let problem = format!(
        "{line}{column}{}: restore the file, or resume the run if its checkpoints are there",
        err.kind()
    );
    RunError::damaged_file(path, problem)
}

/// Reads all rows of a table that not every run has; `None` without the file.
fn rows_if_there<R: DeserializeOwned>(path: &Path) -> Result<Option<Vec<R>>, RunError> {
    file_exists(path)?.then(|| rows(path)).transpose()
}

/// Reads the complete rows of a table that is being written; a last row without line end is
/// skipped.
fn whole_rows<R: DeserializeOwned>(path: &Path) -> Result<Vec<R>, RunError> {
    let text = match std::fs::read(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Vec::new(),
        read => read.map_err(RunError::read_error_mapper(path))?,
    };
    let end = text.iter().rposition(|&byte| byte == b'\n');
    let whole = &text[..end.map_or(0, |end| end + 1)];
    let rows = csv::Reader::from_reader(whole).into_deserialize();
    rows.collect::<Result<_, _>>().map_err(|error| malformed(path, error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::presets::{Budget, Method};

    #[test]
    fn a_run_has_seconds_where_every_rollout_has() {
        let mut run = RunData::empty("run", Budget::Smoke.preset_experiment(Method::Covers));
        assert_eq!(run.training_seconds(), Some(0.0));
        // of a process after a crash that took the table with it
        run.timings = vec![TimingRow::default()];
        assert_eq!(run.training_seconds(), None);
    }

    /// Rollouts that were discarded have no rows, and their policies may be created all the same.
    #[test]
    fn a_policy_exists_from_its_first_decision_on() {
        let problem = |rows: &[(usize, usize)]| {
            let row = |&(decisions, policy)| RolloutRow { decisions, policy, ..Default::default() };
            let rows: Vec<RolloutRow> = rows.iter().map(row).collect();
            check_rollouts(Path::new("run"), &rows).map_err(|error| error.to_string())
        };
        assert_eq!(problem(&[(80, 0), (160, 0), (720, 3)]), Ok(()));
        for rows in [[(80, 0), (160, 161)], [(MAX_POLICIES, 0), (MAX_POLICIES, MAX_POLICIES)]] {
            let message = problem(&rows).unwrap_err();
            assert!(message.contains("metrics.csv, rollout 1: `policy`"), "{message}");
        }
        let backwards = problem(&[(160, 0), (80, 0)]).unwrap_err();
        assert!(backwards.contains("`decisions` is less than before"), "{backwards}");
    }

    /// A table that was sorted by variants has the rows of a group apart.
    #[test]
    fn a_group_is_named_once_wherever_its_rows_are() {
        let mut run = RunData::empty("run", Budget::Smoke.preset_experiment(Method::Covers));
        let row = |group: &str| ScoreRow { group: group.to_owned(), ..ScoreRow::default() };
        run.scores = ["b", "a", "b"].map(row).to_vec();
        assert_eq!(run.scored_groups(), ["b", "a"]);
    }

    #[test]
    fn distances_are_held_to_chance_or_to_the_threshold_of_the_paper() {
        let mut run = RunData::empty("run", Budget::Smoke.preset_experiment(Method::Covers));
        let row = RolloutRow {
            distances: vec![Some(0.5), None],
            permutation_maxima: vec![Some(0.25), None],
            ..RolloutRow::default()
        };
        assert_eq!(
            run.policy_distance_thresholds(&row),
            [None, None],
            "sources of evidence have no common unit"
        );
        let learner::LearnerSettings::Covers(settings) = &mut run.experiment.learner else {
            panic!("covers learns by PPO");
        };
        settings.grouping = serde_json::from_str(r#"{"calibrated": {}}"#).unwrap();
        assert_eq!(run.policy_distance_thresholds(&row), [Some(0.25), None]);
        run.experiment.learner = Method::Paper.learner_settings();
        assert_eq!(run.policy_distance_thresholds(&row), [Some(1.0), Some(1.0)]);
    }
}
