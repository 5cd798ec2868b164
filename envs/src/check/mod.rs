//! Checks of the environments by themselves: can a script solve them, are variants mirror images, do they do what Meta-World's do.
//!
//! Each check is a function that returns rows of figures; `covers check` prints them.

mod experts;
mod npz;
mod parallel;
mod parity;
mod recording;
mod symmetry;

pub use experts::{ExpertRow, experts};
pub use parity::{ParityRow, parity};
pub use recording::RecordingError;
pub use symmetry::{SymmetryRow, symmetry};

use crate::EnvError;

/// The generator of seed 0.
fn first_seed() -> rand_chacha::ChaCha8Rng {
    rand::SeedableRng::seed_from_u64(0)
}

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
