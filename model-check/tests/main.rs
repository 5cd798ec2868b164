//! The integration tests of this crate as one program, which is compiled and linked once.

#![allow(clippy::unwrap_used, reason = "tests and their helpers")]

mod constraints;
mod parts;
mod robots;
mod seeded;
