//! Actor-critics on a GPU.

pub(crate) mod network;
pub(crate) mod policy;
