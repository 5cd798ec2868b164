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
pub(crate) mod update;
mod workspace;
