//! Updates on a GPU against the same updates on the processor. A software driver will do.

#![allow(clippy::unwrap_used, reason = "tests and their helpers")]

#[path = "../common/mod.rs"]
#[allow(dead_code, reason = "other tests use the rest")]
mod common;
mod update;
