//! Everything that can go wrong, one enum per stage: loading, simulating, drawing.

mod model;
mod render;
mod sim;

pub use model::ModelError;
pub use render::{ContextError, RenderError};
pub use sim::{Quantity, SimError};
pub(crate) use sim::{check_finite, check_length};

/// Any error of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MujocoError {
    /// A model could not be loaded, or lacks a name.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A simulation diverged or was given bad values.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// An image could not be drawn.
    #[error(transparent)]
    Render(#[from] RenderError),
}
