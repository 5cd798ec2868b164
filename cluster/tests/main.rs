//! The integration tests of this crate as one program, which is compiled and linked once.
//! `allocations.rs` is a program of its own.

#![allow(clippy::expect_used, clippy::unwrap_used, reason = "tests and their helpers")]

mod certificate;
mod common;
mod distance;
mod fuzz;
mod fuzz_case;
mod hostile;
mod oracle;
mod oracles;
mod reservoir;
mod transport;
mod weighted;
