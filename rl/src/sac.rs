//! Soft actor-critic.

mod gradient;
pub(crate) mod history;
mod minibatch;
pub(crate) mod network;
pub(crate) mod policy;
mod reader;
pub(crate) mod settings;
mod squashed;
pub(crate) mod stats;
mod units;
pub(crate) mod update;
mod workspace;
