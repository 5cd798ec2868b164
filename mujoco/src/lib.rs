//! Safe wrapper of MuJoCo 2.2.2, or 3.2 or later: simulation of models, and off-screen rendering.
//!
//! Three main types, one file each:
//! - [`Model`]: compiled MJCF model, immutable, shared through `Arc` by any number of threads;
//! - [`Data`]: one simulation of it; may move between threads;
//! - [`Renderer`]: off-screen renderer; stays on its thread.
//!
//! Names are converted to typed ids once ([`Model::body`] and similar), where an unknown name is an
//! error. Values are plain arrays: positions `[f64; 3]` in metres, quaternions `[f64; 4]` in
//! the order (w, x, y, z), images `[H, W, 3]` of bytes with row 0 at the top.
//!
//! ```
//! use std::sync::Arc;
//!
//! fn main() -> Result<(), mujoco::MujocoError> {
//!     let model = Arc::new(mujoco::Model::from_xml(
//!         r#"<mujoco><worldbody>
//!              <camera name="top" pos="0 0 2"/>
//!              <body name="ball" pos="0 0 1"><freejoint/><geom size="0.1" rgba="1 0 0 1"/></body>
//!            </worldbody></mujoco>"#,
//!     )?);
//!     let (ball, camera) = (model.body("ball")?, model.camera("top")?);
//!     let mut data = mujoco::Data::new(model.clone());
//!     let mut renderer = mujoco::Renderer::new(model, 64, 64, mujoco::RenderOptions::default())?;
//!     let mut image = vec![0; renderer.image_len()];
//!     for _ in 0..10 {
//!         data.step(5)?;
//!         data.forward()?;
//!         renderer.render(&mut data, camera, &mut image)?;
//!     }
//!     assert!(data.body_position(ball)[2] < 1.0, "the ball falls");
//!     Ok(())
//! }
//! ```
//!
//! MuJoCo's silent failures are errors here: a diverging step, a NaN control, a dropped contact. An
//! error that MuJoCo itself calls fatal prints its message and aborts the process.
//!
//! Two environment variables matter. `COVERS_GL` (`egl` or `osmesa`) restricts the choice of
//! OpenGL. `LP_NUM_THREADS` sizes the thread pool of Mesa's software renderer. The first model that
//! a process loads sets it to 0, because small images are drawn faster without the pool, but only
//! if the variable is unset and the process has one thread. So load a model before starting
//! threads.
//!
//! [`Model::as_raw`], [`Data::as_raw`], [`Data::as_mut_ptr`] and the functions of [`raw`] give
//! access to everything that the wrapper has no method for.

/// Raw declarations of MuJoCo's C library, for [`Model::as_raw`] and [`Data::as_mut_ptr`].
pub use mujoco_sys as raw;

mod arrays;
mod backend;
mod data;
mod error;
mod fields;
mod gl;
pub mod ids;
mod init;
mod load;
mod model;
mod poses;
mod references;
mod releases;
mod renderer;
mod state;
mod vfs;

pub use arrays::{IntegerArray, NumberArray, RowEdit};
pub use backend::OpenGlBackend;
pub use data::{Contact, Data};
pub use error::{ModelError, MujocoError, OpenGlContextError, RenderError, SimError, SimQuantity};
pub use gl::opengl_description;
pub use ids::{ActuatorId, BodyId, CameraId, GeomId, JointId, MocapId, RendererId, SiteId};
pub use init::{REFERENCE_RELEASE, is_reference_release, library_version};
pub use model::{GeomShape, JointType, Model};
pub use renderer::{
    CameraAndMirror, FreeCamera, RenderMirror, RenderOptions, Renderer, StaticBackdrop,
};
pub use state::State;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
