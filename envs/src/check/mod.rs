//! Checks of the environments by themselves: can a script solve them, are variants mirror images.
//!
//! Each check is a function that returns rows of figures; `covers check` prints them.

mod experts;
mod parallel;
mod symmetry;

pub use experts::{ExpertRow, experts};
pub use symmetry::{SymmetryRow, symmetry};

use crate::EnvError;

fn check_seeds(seeds: u64) -> Result<(), EnvError> {
    if seeds > 0 {
        return Ok(());
    }
    Err(EnvError::Setting {
        name: "seeds",
        value: seeds.to_string(),
        expected: "at least 1",
    })
}
