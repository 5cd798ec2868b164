//! A replay: past steps of episodes, sampled again and again.

mod episode;
pub(crate) mod recorded;
pub(crate) mod ring;
pub(crate) mod settings;
pub(crate) mod state;
