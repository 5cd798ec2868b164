//! Measures recognition in worlds that nobody tuned it for: whole streams, with stand-ins for
//! policies that learn.
//!
//! `cargo run --release -p covers-evidence --example worlds_study -- 1000 10`

mod report;
mod stand_in;
mod trial;

use std::time::Instant;

use rayon::prelude::*;
use worlds::{Kind, World};

use report::Report;
use trial::{Trial, TrialError};

fn main() -> Result<(), TrialError> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |index: usize, default: u64| match arguments.get(index) {
        Some(text) => text.parse().map_err(|_| TrialError::Argument(text.clone())),
        None => Ok(default),
    };
    let (first, count) = (number(0, 1000)?, number(1, 10)?);
    let only = arguments.get(2);
    println!("{}", Report::HEADER);
    for kind in Kind::ALL {
        if only.is_some_and(|only| only != kind.name()) {
            continue;
        }
        let clock = Instant::now();
        let worlds = (first..first + count).into_par_iter();
        let outcomes = worlds.map(|seed| Trial::of(World::draw(kind, seed))?.run());
        let outcomes = outcomes.collect::<Result<Vec<_>, TrialError>>()?;
        println!("{}", Report::of(kind, &outcomes));
        eprintln!("{}: {:.0} s", kind.name(), clock.elapsed().as_secs_f64());
    }
    Ok(())
}
