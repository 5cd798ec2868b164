//! What every task must do, as functions for the tests of whoever writes one.

mod experts;
mod symmetry;

pub use experts::{ExpertRow, experts};
pub use symmetry::{SymmetryRow, symmetry};
