//! Tests of the check of models.

mod parts;
mod robots;
mod seeded;
