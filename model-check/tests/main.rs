//! Tests of the check of models.

#![allow(clippy::unwrap_used)]

mod parts;
mod robots;
mod seeded;
