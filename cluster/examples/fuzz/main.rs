//! Solves random hostile inputs and holds every answer to its certificate and, where there is one,
//! to an oracle.
//!
//! `cargo run --release -p covers-cluster --example fuzz -- 1000000 [first seed]`

use std::collections::BTreeMap;
use std::panic::catch_unwind;
use std::process::ExitCode;
use std::time::{Duration, Instant};

mod case;
mod oracle;

fn main() -> ExitCode {
    let mut numbers = std::env::args().skip(1).map(|text| text.parse().ok());
    let inputs: u64 = numbers.next().flatten().unwrap_or(100_000);
    let first: u64 = numbers.next().flatten().unwrap_or(0);
    let mut counts = BTreeMap::new();
    let mut slowest = (Duration::ZERO, first);
    let start = Instant::now();
    for seed in first..first + inputs {
        let begun = Instant::now();
        match catch_unwind(|| case::run(seed)) {
            Ok(Ok(outcome)) => *counts.entry(outcome).or_insert(0_u64) += 1,
            Ok(Err(wrong)) => return fail(seed, &wrong),
            Err(_) => return fail(seed, "panicked"),
        }
        slowest = slowest.max((begun.elapsed(), seed));
    }
    println!("{inputs} inputs in {:.1?}: {counts:?}", start.elapsed());
    println!("slowest: input {} took {:.1?}", slowest.1, slowest.0);
    ExitCode::SUCCESS
}

fn fail(seed: u64, what: &str) -> ExitCode {
    eprintln!("input {seed}: {what}");
    ExitCode::FAILURE
}
