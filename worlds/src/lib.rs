//! Small image-based worlds, drawn from a seed, in which groups of tasks differ in
//! chosen properties.
//!
//! A learner that assigns tasks to policies by itself should be tested in worlds that it was not
//! tuned for. This crate draws such worlds: a hand moves on a plane, seen from above, and the
//! reward depends on its position relative to an object. A *group* fixes the object's appearance,
//! the reward and the dynamics of the hand. A [`WorldKind`] names the properties in which the
//! groups of a world differ, and may add a nuisance: a change with time that calls for no other
//! policy. No simulator is needed, and a step takes microseconds.
//!
//! - [`World::random`] draws groups and their surroundings: clutter, light, camera noise,
//!   placements.
//! - [`TaskStream`] shows the groups one after another, as an [`rl::VectorEnv`] of pictures
//!   `[48, 48, 6]`.
//! - [`TaskStream::expert_action`] solves any group, and can also act as if in the wrong one.
//!
//! Every episode shows one of the four variants of D2. Simulation uses one frame of reference and
//! mirrors the result, so variants are mirror images of each other to the bit.
//!
//! ```
//! use rl::{Observations, VectorEnv};
//! use worlds::{WorldKind, TaskStream, GroupVisit, World};
//!
//! let world = World::random(WorldKind::Appearance, 1000);
//! let visits = vec![GroupVisit::new(0, 2), GroupVisit::new(1, 2)];
//! let mut stream = TaskStream::new(world, visits, 4)?;
//! let mut observations = Observations::new(stream.spec());
//! stream.reset(&mut observations)?;
//! assert_eq!(observations.images.len(), 4 * 48 * 48 * 6);
//! # Ok::<(), Box<dyn std::error::Error + Send + Sync>>(())
//! ```

mod appearance;
mod episode;
mod group;
mod kind;
mod picture;
mod scene;
mod stream;
mod world;

pub use appearance::{Appearance, Shape, Texture};
pub use group::{HandDynamics, RewardFunction, TaskGroup};
pub use kind::{TaskGroupProperty, WorldKind};
pub use scene::SceneSettings;
pub use stream::{DEFAULT_HORIZON, GroupVisit, StreamError, TaskStream};
pub use world::World;

/// Compiles and runs the example of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
