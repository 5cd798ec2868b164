#![doc = include_str!("../README.md")]

mod check;
mod compare;
mod effect;
mod error;
mod maps;
mod mirror;
mod names;
mod pairs;
mod read;
mod snapshot;

pub use check::{CheckSettings, ModelCheck, check};
pub use compare::{Difference, Measure};
pub use error::CheckError;
pub use maps::{SignedPermutation, SymmetryMaps};
pub use mirror::Plane;
pub use pairs::Corrections;
pub use read::read_model;
pub use snapshot::Kind;
