//! Whatever happens to a run: it says what happened, loses no more than it must, and goes on to the
//! bytes that it would have written anyway.
//!
//! `make test` runs a short version. With `COVERS_FAULTS=full`, as `make faults` sets it, there are
//! 200 kills and every method.

#![allow(clippy::unwrap_used)]

mod checkpoints;
mod common;
mod disks;
mod failures;
#[path = "../common/faulty.rs"]
mod faulty;
mod kills;
mod power;
#[path = "../common/runs.rs"]
mod runs;
#[path = "../common/scratch.rs"]
mod scratch;
mod signals;
mod sweeps;
mod writers;
