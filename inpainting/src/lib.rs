#![doc = include_str!("../README.md")]

mod camera;
mod color;
mod error;
mod inpainter;
mod links;
mod mark;

#[cfg(test)]
mod tests;

pub use camera::{Extrinsics, Intrinsics, PinholeCamera};
pub use color::ColorCorrection;
pub use error::InpaintingError;
pub use inpainter::{Inpainter, InpainterSettings};
pub use links::Link;
pub use mark::Mark;
