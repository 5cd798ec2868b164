//! Study of recognition in worlds that were not used for tuning: whole streams, with stand-ins for
//! policies.
//!
//! `cargo run --release -p covers-benches --example worlds_study -- 1000 10 [KIND]`

mod baseline;
mod cases;
mod record;
mod scores;
mod trial;

use std::error::Error;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use clap::builder::PossibleValuesParser;
use clap::{Parser, ValueEnum};
use worlds::WorldKind;

use cases::{AssignmentRule, StudyCase, VisitPlan};
use record::{HEADER, StudyRecord, StudyResults, table_row};
use trial::StreamTrial;

type Answer<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// Assigns streams of drawn worlds by the learner's rule and by simple baselines.
///
/// Without options it prints the tables of all worlds, and of visits of one rollout to thirty.
#[derive(Clone, Debug, Parser)]
struct Arguments {
    /// Seed of the first world
    #[arg(default_value_t = 1000)]
    first: u64,
    /// Worlds of each kind
    #[arg(default_value_t = 10)]
    count: u64,
    /// Kind of the worlds; without it all kinds
    #[arg(value_parser = PossibleValuesParser::new(StudyCase::all().iter().map(StudyCase::name)))]
    kind: Option<String>,
    /// Rule of assignment; without it all rules
    #[arg(long)]
    rule: Option<AssignmentRule>,
    #[command(flatten)]
    plan: VisitPlan,
    /// File to which each world adds a line as it is done; worlds that it holds are not run again
    #[arg(long)]
    csv: Option<PathBuf>,
}

/// Stream of one world, and the rule that assigns it.
struct Job {
    case: StudyCase,
    rule: AssignmentRule,
    plan: VisitPlan,
    seed: u64,
}

impl Arguments {
    /// Returns the streams of each table.
    fn tables(&self) -> Vec<Vec<Job>> {
        let mut tables = vec![self.table(&self.plan, &StudyCase::all())];
        if self.plan == VisitPlan::default() {
            let few = [WorldKind::Appearance, WorldKind::Target].map(StudyCase::Kind);
            tables
                .extend(VisitPlan::fixed_length_plans().iter().map(|plan| self.table(plan, &few)));
        }
        tables.retain(|jobs| !jobs.is_empty());
        tables
    }

    /// Returns the streams of one table. Rows alternate, so that a study that is interrupted has as
    /// many worlds of each.
    fn table(&self, plan: &VisitPlan, cases: &[StudyCase]) -> Vec<Job> {
        let seeds = self.first..self.first + self.count;
        let jobs = seeds.flat_map(|seed| cases.iter().map(move |&case| (seed, case)));
        let jobs = jobs.flat_map(|(seed, case)| {
            let job = move |&rule| Job { case, rule, plan: plan.clone(), seed };
            AssignmentRule::value_variants().iter().map(job)
        });
        let is_kind = |job: &Job| self.kind.as_ref().is_none_or(|kind| kind == job.case.name());
        // the visits of a rare group are fixed
        let fits = |job: &Job| job.case != StudyCase::RareGroup || job.plan == VisitPlan::default();
        let is_asked = |job: &Job| self.rule.is_none_or(|rule| rule == job.rule);
        jobs.filter(is_kind).filter(fits).filter(is_asked).collect()
    }
}

fn main() -> Answer<()> {
    let arguments = Arguments::parse();
    let results = StudyResults::open(arguments.csv.as_deref())?;
    let tables = arguments.tables();
    if tables.is_empty() {
        return Err(
            "no stream to run: `rare-group` has visits of its own, so leave out --visits and \
                    --stay, and the number of worlds must be at least 1"
                .into(),
        );
    }
    for jobs in tables {
        let records = run_all(&jobs, &results)?;
        let StudyRecord { visits, stay, .. } = StudyRecord::new(&jobs[0]);
        println!("Visits: {visits}, of {stay} rounds\n\n{HEADER}");
        for job in jobs.iter().filter(|job| job.seed == arguments.first) {
            let own = records.iter().filter(|record| record.shares_row_with(job));
            println!("{}", table_row(job, &own.collect::<Vec<_>>()));
        }
        println!();
    }
    Ok(())
}

/// Runs the streams of one table on threads of their own, and returns their records. Decisions are
/// made in rayon's pool and timed.
fn run_all(jobs: &[Job], results: &StudyResults) -> Answer<Vec<StudyRecord>> {
    let next = Mutex::new(jobs.iter());
    let take = || next.lock().unwrap_or_else(PoisonError::into_inner).next();
    let work = || {
        let taken = std::iter::from_fn(take);
        taken.map(|job| run(job, results)).collect::<Answer<Vec<_>>>()
    };
    std::thread::scope(|scope| {
        let threads = 0..rayon::current_num_threads();
        let threads: Vec<_> = threads.map(|_| scope.spawn(work)).collect();
        let mut records = Vec::new();
        for thread in threads {
            records.extend(thread.join().map_err(|_| "a thread panicked")??);
        }
        Ok(records)
    })
}

/// Returns the record of one world, from the file if it is there.
fn run(job: &Job, results: &StudyResults) -> Answer<StudyRecord> {
    if let Some(record) = results.find(job) {
        return Ok(record.clone());
    }
    let outcome = StreamTrial::new(job)?.run()?;
    let record = scores::count_assignments(job, &outcome);
    results.add(&record)?;
    Ok(record)
}

#[cfg(test)]
mod tests {
    use super::cases::range;
    use super::*;

    #[test]
    fn ranges_rise_from_one_on() {
        assert_eq!(range("4-12"), Ok(4..=12));
        for wrong in ["5", "0-4", "9-4", "a-b"] {
            assert!(range(wrong).unwrap_err().contains("rising"), "{wrong}");
        }
    }

    /// The table of worlds, and five of streams; one of a given stream.
    #[test]
    fn without_options_there_are_tables_of_worlds_and_of_streams() {
        let tables = |words: &str| {
            let words = std::iter::once("study").chain(words.split_whitespace());
            let arguments = Arguments::parse_from(words);
            arguments.tables().iter().map(Vec::len).collect::<Vec<_>>()
        };
        assert_eq!(tables("7 3"), [3 * 18 * 5, 30, 30, 30, 30, 30]);
        assert_eq!(tables("7 1 target --rule evidence"), [1; 6]);
        assert_eq!(tables("7 1 collapse"), [5]);
        assert_eq!(tables("7 1 --visits 100"), [17 * 5]);
        assert_eq!(tables("7 1 rare-group --visits 100"), [0; 0], "an error of the program");
    }
}
