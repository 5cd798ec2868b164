//! The integration tests of this crate as one program, which is compiled and linked once.

#![allow(clippy::unwrap_used, reason = "tests and their helpers")]

mod common;
mod limits;
mod merging;
mod recogniser;
mod state;
