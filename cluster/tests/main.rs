//! The integration tests of this crate as one program, which is compiled and linked once.
//! `allocations.rs` is a program of its own.

#![allow(
    clippy::expect_used,
    clippy::unwrap_used,
    reason = "tests and their helpers"
)]

mod assigner;
mod assigner_input;
mod assigner_study;
mod certificate;
mod common;
mod distance;
mod fuzz;
mod hostile;
mod oracles;
mod properties;
mod reservoir;
mod transport;
mod weighted;

#[path = "../examples/fuzz/case.rs"]
mod case;
#[path = "../examples/fuzz/oracle.rs"]
mod oracle;
#[path = "../examples/assigner_study/population.rs"]
mod population;
// the study names the rules; here they are numbers
#[allow(dead_code)]
#[path = "../examples/assigner_study/rules.rs"]
mod rules;
