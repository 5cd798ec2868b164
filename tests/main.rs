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
mod learns;
mod modules;
mod output;
mod overrides;
mod pages;
mod parity;
mod ppo_table;
mod pretrained;
mod ranks;
mod render;
mod report;
mod runs;
mod settings;
mod table1;
#[cfg(feature = "tui")]
mod terminal;
mod variants;
mod watch;
mod words;

#[path = "../fuzz/src/targets/mod.rs"]
mod targets;
