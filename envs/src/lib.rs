//! Table-top manipulation tasks with D2 variants on MuJoCo, seen by a top-down camera.
//!
//! A group of tasks ([`TaskGroup`]) has four variants that are images of one another under
//! [`symmetry::D2`] ([`TaskVariant`]). The crate has fourteen groups; a program adds its own by
//! implementing [`Task`]. A learner observes the table without the arm, a disc at the gripper, and
//! the episode's first picture or a close-up of the table below the hand ([`ExtraViews`]).
//!
//! - [`VecEnv`]: many environments on worker threads, pictures included, for training.
//! - [`TableTop`]: one environment without a picture, for state-based work and scripted experts.
//! - [`SimulatedArm`]: the arm of a [`TableTop`] as a [`robots::Robot`], like a real arm.
//! - [`SceneRenderer`]: pictures of a [`TableTop`].
//! - [`TaskRegistry`]: groups by name.
//! - [`conformance`]: rules for tasks, as functions for tests.
//! - [`mujoco`]: the wrapper whose models, simulations and errors this crate exposes.
//!
//! ```
//! use envs::{ACTION_DIM, StepBuffers, TaskGroup, VecEnv, VecEnvSettings};
//! use symmetry::D2;
//!
//! fn main() -> Result<(), envs::EnvError> {
//!     let settings = VecEnvSettings { num_envs: 4, ..VecEnvSettings::default() };
//!     let mut env = VecEnv::new(settings, TaskGroup::BUTTON_PRESS, &D2::ALL)?;
//!     let mut batch = StepBuffers::new(&settings);
//!     env.reset(batch.observations_mut())?;
//!     for _ in 0..50 {
//!         // a policy would choose them from batch.images and batch.vectors
//!         let actions = [0.5; 4 * ACTION_DIM];
//!         env.step(&actions, batch.step_results_mut())?;
//!     }
//!     assert!(batch.truncated.iter().all(|&end| end), "50 decisions are an episode");
//!     Ok(())
//! }
//! ```

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

mod actuation;
mod arm_occlusion;
mod batch;
mod camera;
pub mod conformance;
mod control;
mod domain_randomiser;
mod embodiment;
mod embodiment_spec;
pub mod embodiments;
mod error;
mod homography;
mod instance_id;
mod layout;
mod messages;
mod mjcf;
mod randomisation;
mod registry;
mod renderer;
pub mod reward;
mod scene;
mod settings;
mod sub_envs;
mod tabletop;
mod task;
pub mod tasks;
mod vec_env;
mod worker;

pub use actuation::{HandActuation, NamedJointPositions, ServoArmController};
pub use batch::{ObservationsMut, StepBuffers, StepResultsMut};
pub use camera::{
    Camera, ExtraViews, GripperMark, Light, Misalignment, ObservationPictures, RGB_CHANNELS,
};
pub use control::{ControlSettings, PHYSICS_STEPS_PER_CONTROL_STEP};
pub use embodiment::Embodiment;
pub use embodiment_spec::{EmbodimentSceneParts, EmbodimentSpec};
pub use error::{EnvError, ReachShortfall};
pub use layout::{HAND_TARGET_START, Layout};
pub use messages::{EnvCommand, EnvFailure, EnvSnapshot};
pub use mujoco::{self, StaticBackdrop};
pub use randomisation::VisualDomainRandomisation;
pub use registry::TaskRegistry;
pub use renderer::{CornerViewRenderer, SceneRenderer, ViewRenderer, ViewSettings};
pub use robots;
pub use scene::{ARM_GEOM_GROUP, Scene};
pub use settings::{MAX_THREADS, VecEnvSettings};
pub use tabletop::{
    ACTION_DIM, ACTION_IRREPS, STATE_DETAILS_DIM, SimulatedArm, StepResult, TableTop,
    TableTopSnapshot, VECTOR_OBSERVATION_DIM, VECTOR_OBSERVATION_IRREPS, VisibleGeom,
    vector_observation,
};
pub use task::{
    EpisodeStart, ExpertCommand, MetaWorldTaskSettings, Placement, StepReward, Task, TaskGroup,
    TaskSceneParts, TaskState, TaskVariant,
};
pub use vec_env::VecEnv;
