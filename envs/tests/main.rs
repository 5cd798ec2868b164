//! The integration tests of this crate as one program, which is compiled and linked once.
//! `allocations.rs` is a program of its own.

#![allow(clippy::unwrap_used, reason = "tests and their helpers")]

mod arm_occlusion;
mod arms;
mod button;
mod common;
mod conformance;
mod foreign_tasks;
mod inpainting;
mod layouts;
mod own_arms;
mod pictures;
mod randomisation;
mod scenes;
mod simulated_arm;
mod solids;
mod tasks;
mod vec_env;
