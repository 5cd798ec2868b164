//! The integration tests of this crate as one program, which is compiled and linked once.
//! `faults/` is a program of its own.

#![allow(clippy::unwrap_used, reason = "tests and their helpers")]

mod blocks;
mod common;
mod dependencies;
mod deploy;
mod device;
mod embedding;
mod events;
mod export;
mod fuzz;
mod learner;
mod learns;
mod modules;
mod off_policy;
mod overrides;
mod pages;
mod parity;
mod ppo_table;
mod pretrained;
mod recognition;
mod render;
mod report;
mod runs;
mod table1;
#[cfg(feature = "tui")]
mod terminal;
mod trials;
mod unsafe_code;
mod variants;
mod watch;

#[path = "../rl/tests/common/guess.rs"]
mod guess;
#[path = "../fuzz/src/targets/mod.rs"]
mod targets;
#[path = "../rl/tests/common/toy.rs"]
mod toy;
