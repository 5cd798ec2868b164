//! The integration tests of this crate as one program, which is compiled and linked once.

#![allow(clippy::unwrap_used, reason = "tests and their helpers")]

mod check;
mod control;
mod damage;
mod gen3;
mod ik;
mod meshes;
mod mjcf;
mod refusals;
mod structures;
mod watchdog;

/// A small arm of our own.
const SIX_JOINT: &str = include_str!("../assets/urdf/six_joint.urdf");
