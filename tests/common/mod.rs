//! What several files of tests share.

pub mod bars;
pub mod scratch;
