//! Tests of learners on toy environments, as one program.

#![allow(clippy::unwrap_used, reason = "tests and their helpers")]

mod algorithm;
mod bars;
mod off_policy;
mod previous_parameters;
mod trials;

#[path = "../../rl/tests/common/guess.rs"]
mod guess;
#[allow(dead_code, reason = "the tests of rl use more of it")]
#[path = "../../rl/tests/common/toy.rs"]
mod toy;
