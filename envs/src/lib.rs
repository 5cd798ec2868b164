//! Table-top manipulation tasks with D2 variants on MuJoCo, seen by a top-down camera.
//!
//! A group of tasks ([`TaskGroup`]) has four variants that are one another's images under
//! [`symmetry::D2`] ([`TaskVariant`]). Four groups come with the crate; a program adds its own by
//! implementing [`Task`]. A learner sees the table without the arm, a disc at the gripper, and the
//! episode's first picture or a close-up of what is under the hand ([`Beside`]).
//!
//! - [`VecEnv`]: many environments on worker threads, pictures included. This is what a learner
//!   uses.
//! - [`TableTop`]: one environment without a picture, for state-based work and scripted experts.
//! - [`SimulatedArm`]: the arm of a [`TableTop`] as a [`robots::Robot`], as real ones are driven.
//! - [`SceneRenderer`]: the picture of a [`TableTop`].
//! - [`TaskRegistry`]: groups by name.
//! - [`conformance`]: what every task must do, as functions for tests.
//! - [`mujoco`]: the wrapper whose models, simulations and errors this crate shows.
//!
//! ```
//! use envs::{ACTION_DIM, Batch, TaskGroup, VecEnv, VecEnvSettings};
//! use symmetry::D2;
//!
//! fn main() -> Result<(), envs::EnvError> {
//!     let settings = VecEnvSettings { num_envs: 4, ..VecEnvSettings::default() };
//!     let mut env = VecEnv::new(settings, TaskGroup::BUTTON_PRESS, &D2::ALL)?;
//!     let mut batch = Batch::new(&settings);
//!     env.reset(batch.observations())?;
//!     for _ in 0..50 {
//!         // a policy would choose them from batch.images and batch.vectors
//!         let actions = [0.5; 4 * ACTION_DIM];
//!         env.step(&actions, batch.step())?;
//!     }
//!     assert!(batch.truncated.iter().all(|&end| end), "50 decisions are an episode");
//!     Ok(())
//! }
//! ```

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

mod batch;
mod camera;
mod carrier;
pub mod carriers;
pub mod conformance;
mod control;
mod disturber;
mod drive;
mod embodiment;
mod error;
mod identity;
mod layout;
mod mjcf;
mod randomisation;
mod registry;
mod renderer;
pub mod reward;
mod rows;
mod scene;
mod settings;
mod sub_envs;
mod tabletop;
mod task;
pub mod tasks;
mod vec_env;
mod view;
mod worker;

pub use batch::{Batch, ObservationsMut, StepMut};
pub use camera::{Beside, Camera, Light, Mark, Pictures, RGB};
pub use carrier::{Carrier, CarrierParts};
pub use control::{Control, PHYSICS_STEPS};
pub use drive::{Drive, Posture, ServoDrive};
pub use embodiment::Embodiment;
pub use error::EnvError;
pub use layout::{HAND_START, Layout};
pub use mujoco::{self, Backdrop};
pub use randomisation::Randomisation;
pub use registry::TaskRegistry;
pub use renderer::SceneRenderer;
pub use robots;
pub use rows::{Failure, Turn};
pub use scene::{ARM_GEOM_GROUP, Scene};
pub use settings::{MAX_THREADS, VecEnvSettings};
pub use tabletop::{
    ACTION_DIM, ACTION_IRREPS, SimulatedArm, Snapshot, Solid, Step, TableTop, VECTOR_DIM,
    VECTOR_IRREPS,
};
pub use task::{
    EpisodeStart, ExpertCommand, Measurement, Parts, Placement, StepReward, Stock, Task, TaskGroup,
    TaskVariant,
};
pub use vec_env::VecEnv;
