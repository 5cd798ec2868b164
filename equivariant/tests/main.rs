//! The integration tests of this crate as one program, which is compiled and linked once.
//! `allocations.rs` is a program of its own.

#![allow(clippy::unwrap_used, reason = "tests and their helpers")]

mod bytes;
mod chunks;
mod common;
mod equivariance;
mod errors;
mod golden;
mod gradients;
mod gru;
mod init;
mod instruction_sets;
mod kernel_space;
mod oracle;
mod pooling;
mod precision;
mod scratch;
mod slices;
mod units;
