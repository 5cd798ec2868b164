//! Counts of one world, their file, and the table of them.

use std::fs::{File, OpenOptions};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use crate::cases::AssignmentRule;
use crate::trial::ROUNDS_PER_ROLLOUT;
use crate::{Answer, Job};

/// Version of the study, which all records of a results file must have. Results of two versions do
/// not belong in one table.
pub const STUDY_VERSION: u32 = 9;

/// Record of one world of the study, in the order of the file's columns: policies, right and wrong
/// assignments, and the slowest decision.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StudyRecord {
    pub version: u32,
    pub rule: AssignmentRule,
    pub kind: String,
    pub seed: u64,
    /// Columns of the plan.
    pub visits: String,
    pub stay: String,
    /// Number of groups, each of which needs a policy of its own.
    pub groups: usize,
    pub policies: usize,
    /// 1 if policies and groups belong to each other one to one.
    pub exact: usize,
    pub turns: usize,
    /// Number of rounds of all turns.
    pub rounds: usize,
    /// Number of turns after their group's first visit; `right` counts those that are right.
    pub known: usize,
    pub right: usize,
    /// Number of first turns of returning groups; `noticed` counts those that are right.
    pub switches: usize,
    pub noticed: usize,
    /// Number of rounds trained on; `foreign` counts those that belong to another policy.
    pub learnt: usize,
    pub foreign: usize,
    /// Number of policies that were merged into another one.
    pub merged: usize,
    /// Time of the decisions of the slowest turn, in microseconds.
    pub slowest_us: u128,
}

impl StudyRecord {
    /// Creates the record of a job's world, with all counts at zero.
    pub fn new(job: &Job) -> Self {
        let rounds = job.plan.rounds();
        Self {
            version: STUDY_VERSION,
            rule: job.rule,
            kind: job.case.name().to_owned(),
            seed: job.seed,
            visits: job.plan.visits.map_or("default".to_owned(), |n| n.to_string()),
            stay: format!("{}-{}", rounds.start(), rounds.end()),
            ..Self::default()
        }
    }

    /// Returns `true` if the record has the kind of worlds and the rule of `job`, so both belong to
    /// one row of the table.
    pub fn shares_row_with(&self, job: &Job) -> bool {
        self.kind == job.case.name() && self.rule == job.rule
    }
}

/// Results of a study, in a file if one is named. A later study with the same file continues it.
pub struct StudyResults {
    file: Option<Mutex<csv::Writer<File>>>,
    known: Vec<StudyRecord>,
}

impl StudyResults {
    /// Opens the file at `path`, created if it is missing, and reads its records; without a path,
    /// no results are kept.
    pub fn open(path: Option<&Path>) -> Answer<Self> {
        let Some(path) = path else {
            let (file, known) = (None, Vec::new());
            return Ok(Self { file, known });
        };
        let rejected = |problem: String| {
            let path = path.display();
            format!(
                "{path}: {problem}, expected version {STUDY_VERSION} of this study; \
                 name another file"
            )
        };
        let file = OpenOptions::new().append(true).create(true).open(path)?;
        let is_new = file.metadata()?.len() == 0;
        let rows = csv::Reader::from_path(path)?.into_deserialize();
        let rows: Result<Vec<StudyRecord>, _> = rows.collect();
        let known = rows.map_err(|error| rejected(error.to_string()))?;
        if let Some(other) = known.iter().find(|record| record.version != STUDY_VERSION) {
            return Err(rejected(format!("it holds version {}", other.version)).into());
        }
        let mut writer = csv::WriterBuilder::new();
        let writer = writer.has_headers(is_new).from_writer(file);
        let shared = Some(Mutex::new(writer));
        Ok(Self { file: shared, known })
    }

    /// Returns the results that the file already held for this job when it was opened, if any.
    pub fn find(&self, job: &Job) -> Option<&StudyRecord> {
        let own = StudyRecord::new(job);
        let is_own =
            |r: &&StudyRecord| (r.seed, &r.visits, &r.stay) == (job.seed, &own.visits, &own.stay);
        self.known.iter().filter(is_own).find(|record| record.shares_row_with(job))
    }

    /// Appends a record to the results file, if there is one, and flushes it.
    pub fn add(&self, record: &StudyRecord) -> Answer<()> {
        let Some(file) = &self.file else {
            return Ok(());
        };
        let mut file = file.lock().unwrap_or_else(PoisonError::into_inner);
        file.serialize(record)?;
        Ok(file.flush()?)
    }
}

pub const HEADER: &str = "| worlds | rule | number | as many policies as groups | exact policies \
| with superfluous policies | most superfluous | with missing policies | most missing \
| right after first visits | switches noticed at once \
| learnt by the wrong policy | rollouts a turn | policies merged | slowest decisions |\n\
|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|";

/// Returns the Markdown line of the results table for one rule in worlds of one kind.
pub fn table_row(Job { case, rule, .. }: &Job, records: &[&StudyRecord]) -> String {
    let count =
        |holds: fn(&StudyRecord) -> bool| records.iter().filter(|r| holds(r)).count() as f64;
    let worlds = |holds| 100.0 * count(holds) / records.len().max(1) as f64;
    let sum =
        |of: fn(&StudyRecord) -> usize| records.iter().map(|record| of(record)).sum::<usize>();
    // a share of nothing is a dash
    let share = |part, whole| match sum(whole) {
        0 => "-".to_owned(),
        whole => format!("{:.1} %", 100.0 * sum(part) as f64 / whole as f64),
    };
    let most = |of: fn(&StudyRecord) -> usize| records.iter().map(|r| of(r)).max().unwrap_or(0);
    let cells = [
        case.name().to_owned(),
        format!("{rule:?}"),
        records.len().to_string(),
        format!("{:.1} %", worlds(|r| r.policies == r.groups)),
        format!("{:.1} %", worlds(|r| r.exact == 1)),
        count(|r| r.policies > r.groups).to_string(),
        most(|r| r.policies.saturating_sub(r.groups)).to_string(),
        count(|r| r.policies < r.groups).to_string(),
        most(|r| r.groups.saturating_sub(r.policies)).to_string(),
        share(|r| r.right, |r| r.known),
        share(|r| r.noticed, |r| r.switches),
        share(|r| r.foreign, |r| r.learnt),
        format!(
            "{:.2}",
            sum(|r| r.rounds) as f64 / (ROUNDS_PER_ROLLOUT * sum(|r| r.turns).max(1)) as f64
        ),
        sum(|r| r.merged).to_string(),
        format!("{} ms", most(|r| r.slowest_us as usize) / 1000),
    ];
    format!("| {} |", cells.join(" | "))
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::PathBuf;

    use worlds::WorldKind;

    use super::*;
    use crate::cases::{StudyCase, VisitPlan};

    fn scratch(name: &str) -> PathBuf {
        let name = format!("worlds-study-{name}-{}.csv", std::process::id());
        std::env::temp_dir().join(name)
    }

    fn job(visits: Option<usize>, rule: AssignmentRule, seed: u64) -> Job {
        let plan = VisitPlan { visits, ..VisitPlan::default() };
        Job { case: StudyCase::Kind(WorldKind::Shape), rule, plan, seed }
    }

    #[test]
    fn the_right_number_of_policies_is_not_enough_to_be_exact() {
        let record =
            |policies, exact| StudyRecord { groups: 4, policies, exact, ..StudyRecord::default() };
        let records = [record(4, 1), record(4, 0), record(6, 0), record(3, 0)];
        let line = table_row(&job(None, AssignmentRule::Network, 7), &records.each_ref());
        let start = "| shape | Network | 4 | 50.0 % | 25.0 % | 1 | 2 | 1 | 1 | - |";
        assert!(line.starts_with(start), "{line}");
        let columns = |text: &str| text.matches('|').count();
        let header: Vec<usize> = HEADER.lines().map(columns).collect();
        assert_eq!(header, [columns(&line); 2]);
    }

    #[test]
    fn lines_of_another_version_are_refused() {
        let path = scratch("version");
        for text in ["kind,seed\nshape,7\n", "version,kind\n9,shape\n"] {
            fs::write(&path, text).unwrap();
            let rejected = StudyResults::open(Some(&path)).err().unwrap();
            let message = rejected.to_string();
            assert!(message.contains("expected version 9"), "{message}");
            assert_eq!(fs::read_to_string(&path).unwrap(), text);
        }
        fs::remove_file(&path).unwrap();
    }

    #[test]
    fn results_are_found_again() {
        let path = scratch("again");
        let results = StudyResults::open(Some(&path)).unwrap();
        let own = job(None, AssignmentRule::Evidence, 7);
        assert_eq!(results.find(&own), None);
        let record = StudyRecord::new(&own);
        results.add(&record).unwrap();
        let again = StudyResults::open(Some(&path)).unwrap();
        assert_eq!(again.find(&own), Some(&record));
        let others = [
            (None, AssignmentRule::Evidence, 8),
            (None, AssignmentRule::Network, 7),
            (Some(9), own.rule, 7),
        ];
        for (visits, rule, seed) in others {
            assert_eq!(again.find(&job(visits, rule, seed)), None);
        }
        let text = fs::read_to_string(&path).unwrap().replace("\n9,", "\n5,");
        fs::write(&path, text).unwrap();
        let rejected = StudyResults::open(Some(&path)).err().unwrap();
        assert!(rejected.to_string().contains("it holds version 5"));
        fs::remove_file(&path).unwrap();
    }
}
