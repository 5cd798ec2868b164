//! The inner loops, written once for all instruction sets, and the layout of what they read.

pub(crate) mod columns;
pub(crate) mod gather;
pub(crate) mod join;
pub(crate) mod lanes;
pub(crate) mod lines;
pub(crate) mod patches;
pub(crate) mod pixels;
pub(crate) mod tiles;
