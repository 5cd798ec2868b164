//! Study of recognition in worlds that were not used for tuning: whole streams, with stand-ins for
//! policies.
//!
//! `cargo run --release -p covers-benches --example worlds_study -- 1000 10 [KIND]`

mod record;
mod scores;
mod trial;

use std::error::Error;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use clap::Parser;
use worlds::{World, WorldKind};

use record::{HEADER, Record, Results, row};
use trial::Trial;

type Answer<T> = Result<T, Box<dyn Error + Send + Sync>>;

#[derive(Clone, Debug, Parser)]
struct Arguments {
    /// Seed of the first world
    #[arg(default_value_t = 1000)]
    first: u64,
    /// Worlds of each kind
    #[arg(default_value_t = 10)]
    count: u64,
    /// Kind of the worlds; without it all kinds
    #[arg(value_parser = kind)]
    kind: Option<WorldKind>,
    #[command(flatten)]
    plan: Plan,
    /// File to which each world adds a line as it is done; worlds that it holds are not run again
    #[arg(long)]
    csv: Option<PathBuf>,
}

/// Shape of a stream. The default visits last three rollouts to ten, with switches in the middle of
/// some.
#[derive(Clone, Debug, clap::Args)]
struct Plan {
    /// Visits of all groups together; without it two of each group
    #[arg(long)]
    visits: Option<usize>,
    /// Rounds that a visit lasts
    #[arg(long, default_value = "12-40", value_parser = range)]
    stay: RangeInclusive<usize>,
}

fn kind(name: &str) -> Result<WorldKind, String> {
    let kind = WorldKind::ALL.into_iter().find(|kind| kind.name() == name);
    let names = || WorldKind::ALL.map(WorldKind::name).join(", ");
    kind.ok_or_else(|| format!("expected one of {}", names()))
}

fn range(word: &str) -> Result<RangeInclusive<usize>, String> {
    let ends = word.split_once('-');
    let ends = ends.and_then(|(from, to)| Some((from.parse().ok()?, to.parse().ok()?)));
    let range = ends.filter(|(from, to)| (1..=*to).contains(from));
    let range = range.map(|(from, to)| from..=to);
    range.ok_or_else(|| "expected two rising numbers from 1 on, such as 12-40".to_owned())
}

fn main() -> Answer<()> {
    let arguments = Arguments::parse();
    let results = Results::open(arguments.csv.as_deref(), &arguments.plan)?;
    let kinds = arguments.kind.map_or(WorldKind::ALL.to_vec(), |kind| vec![kind]);
    let records = run_all(&kinds, &arguments, &results)?;
    println!("{HEADER}");
    for kind in kinds {
        let own = records.iter().filter(|record| record.kind == kind.name());
        println!("{}", row(kind.name(), &own.collect::<Vec<_>>()));
    }
    Ok(())
}

/// Runs the worlds on threads of their own, and returns their records. Decisions are made in
/// rayon's pool and timed. Kinds alternate, so that a study that is interrupted has as many of
/// each.
fn run_all(kinds: &[WorldKind], arguments: &Arguments, results: &Results) -> Answer<Vec<Record>> {
    let seeds = arguments.first..arguments.first + arguments.count;
    let worlds = seeds.flat_map(|seed| kinds.iter().map(move |&kind| (kind, seed)));
    let next = Mutex::new(worlds);
    let take = || next.lock().unwrap_or_else(PoisonError::into_inner).next();
    let work = || {
        let taken = std::iter::from_fn(take);
        taken.map(|(kind, seed)| run(kind, seed, arguments, results)).collect::<Answer<Vec<_>>>()
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
fn run(kind: WorldKind, seed: u64, arguments: &Arguments, results: &Results) -> Answer<Record> {
    if let Some(record) = results.known(kind, seed) {
        return Ok(record.clone());
    }
    let outcome = Trial::of(World::random(kind, seed), &arguments.plan)?.run()?;
    let record = scores::record(kind, seed, &arguments.plan, &outcome);
    results.add(&record)?;
    Ok(record)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_rise_from_one_on() {
        assert_eq!(range("4-12"), Ok(4..=12));
        for wrong in ["5", "0-4", "9-4", "a-b"] {
            assert!(range(wrong).unwrap_err().contains("rising"), "{wrong}");
        }
    }
}
