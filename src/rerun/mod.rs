//! A run and its policies at work as a recording for the [Rerun](https://rerun.io) viewer. Behind
//! the feature `rerun`, since its SDK has more dependencies than all of this project.

#[cfg(feature = "rerun")]
mod blueprint;
mod command;
#[cfg(feature = "rerun")]
mod episode;
#[cfg(feature = "rerun")]
mod recording;
#[cfg(feature = "rerun")]
mod scene;
#[cfg(feature = "rerun")]
mod stream;

pub use command::RerunOptions;
