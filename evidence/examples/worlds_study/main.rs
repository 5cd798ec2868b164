//! Measures recognition in worlds that nobody tuned it for: whole streams, with stand-ins for
//! policies that learn.
//!
//! `cargo run --release -p covers-evidence --example worlds_study -- 1000 10 [KIND]`
//!
//! `--visits N` makes streams of N visits instead of two of each group, `--stay A-B` visits of A to
//! B rounds. `--csv FILE` adds a line for each world as it is done; worlds that FILE holds are not
//! run again, so a study can be broken off and continued. `--explain` prints every turn.

mod arguments;
mod record;
mod report;
mod rollout;
mod scores;
mod stand_in;
mod trial;

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use worlds::{Kind, World};

use arguments::Arguments;
use record::{Record, Results};
use report::Report;
use trial::{Trial, TrialError};

fn main() -> Result<(), TrialError> {
    let arguments = Arguments::read(std::env::args().skip(1))?;
    let results = Results::open(arguments.csv.as_deref(), &arguments.plan)?;
    // kinds in turn, so that a study that is broken off has as many worlds of each
    let worlds: Vec<(Kind, u64)> = arguments
        .seeds
        .clone()
        .flat_map(|seed| arguments.kinds.iter().map(move |&kind| (kind, seed)))
        .collect();
    let records = run_all(&worlds, &arguments, &results)?;
    println!("{}", Report::HEADER);
    for &kind in &arguments.kinds {
        let own = records.iter().filter(|record| record.kind == kind);
        println!("{}", Report::new(kind, &own.copied().collect::<Vec<_>>()));
    }
    Ok(())
}

/// Runs worlds in their order on all threads.
fn run_all(
    worlds: &[(Kind, u64)],
    arguments: &Arguments,
    results: &Results,
) -> Result<Vec<Record>, TrialError> {
    let next = AtomicUsize::new(0);
    let records = Mutex::new(Ok(Vec::new()));
    let work = || {
        while let Some(&(kind, seed)) = worlds.get(next.fetch_add(1, Ordering::Relaxed)) {
            let record = run(kind, seed, arguments, results);
            let Ok(mut records) = records.lock() else {
                return;
            };
            match (records.as_mut(), record) {
                (Ok(records), Ok(record)) => records.push(record),
                (Ok(_), Err(error)) => *records = Err(error),
                (Err(_), _) => return,
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..rayon::current_num_threads() {
            scope.spawn(work);
        }
    });
    records
        .into_inner()
        .unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// The record of one world, from the file if it is there.
fn run(
    kind: Kind,
    seed: u64,
    arguments: &Arguments,
    results: &Results,
) -> Result<Record, TrialError> {
    if let Some(record) = results.known(kind, seed) {
        return Ok(record);
    }
    let trial = Trial::of(World::draw(kind, seed), &arguments.plan)?;
    let outcome = trial.run()?;
    let record = scores::record(kind, seed, &outcome);
    results.add(&record)?;
    if arguments.explain {
        let lines = outcome.log.join("\n");
        eprintln!("{} {seed}: {record:?}\n{lines}", kind.name());
    }
    Ok(record)
}
