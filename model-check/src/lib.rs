#![doc = include_str!("../README.md")]

mod actuators;
mod check;
mod compare;
mod connections;
mod constraints;
mod effect;
mod error;
mod maps;
mod mirror;
mod names;
mod page;
mod pairs;
mod read;
mod snapshot;

pub use check::{ModelSymmetryReport, ModelSymmetrySettings, check_model_symmetry};
pub use compare::{DifferenceMeasure, MirrorDifference};
pub use error::ModelSymmetryError;
pub use maps::{SignedPermutation, SymmetryMaps};
pub use mirror::MirrorPlane;
pub use pairs::PlaneAndPairCorrections;
pub use read::read_model;
pub use snapshot::ModelObjectKind;
