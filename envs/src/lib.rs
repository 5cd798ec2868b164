//! Table-top manipulation tasks with D2 variants on MuJoCo, seen by a top-down camera.
//!
//! Four task groups ([`TaskGroup`]), each in four variants that are one another's images under [`symmetry::D2`]:
//! 16 tasks in all ([`TaskVariant`]). A learner sees the table without the arm, a disc at the gripper, and the episode's first picture.
//!
//! - [`VecEnv`]: many environments on worker threads, pictures included. This is what a learner uses.
//! - [`TableTop`]: one environment without a picture, for state-based work and scripted experts.
//! - [`Painter`]: the picture of a [`TableTop`].
//!
//! ```
//! use envs::{Camera, Dynamics, Embodiment, Scene, TableTop, TaskGroup};
//! use rand::SeedableRng;
//! use std::sync::Arc;
//! use symmetry::D2;
//!
//! # fn main() -> Result<(), envs::EnvError> {
//! let scene = Scene::new(TaskGroup::DrawerClose, Embodiment::Sawyer, Camera::default())?;
//! let mut table = TableTop::new(Arc::new(scene), Dynamics::default())?;
//! let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
//! table.reset(D2::FlipX, &mut rng)?;
//! let mut succeeded = false;
//! loop {
//!     let action = table.expert_action()?;
//!     let step = table.step(&action)?;
//!     succeeded |= step.success;
//!     if step.truncated {
//!         break;
//!     }
//! }
//! assert!(succeeded);
//! # Ok(())
//! # }
//! ```

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

mod camera;
mod error;
pub mod inpainting;
mod picture;
pub mod reward;
mod scene;
mod settings;
mod share;
mod tabletop;
mod task;
pub mod tasks;
mod vec_env;
mod worker;

pub use camera::{Camera, Light, Mark};
pub use error::EnvError;
pub use picture::{IMAGE_CHANNELS, Painter, RGB};
pub use scene::{Embodiment, HAND_START, Scene};
pub use settings::VecEnvSettings;
pub use tabletop::{
    ACTION_DIM, ACTION_IRREPS, Dynamics, Step, TableTop, VECTOR_DIM, VECTOR_IRREPS,
};
pub use task::{
    Evaluation, ExpertCommand, Measurement, Parts, Placement, Task, TaskGroup, TaskVariant,
};
pub use vec_env::{Failure, ObservationsMut, StepMut, VecEnv};
