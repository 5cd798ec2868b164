//! Moving pictures of policies: GIF, and mp4 where `ffmpeg` is on the path.

mod command;
mod error;
mod font;
mod gallery;
mod gif;
mod helper;
mod mosaic;
mod mp4;
mod palette;
mod show;
mod studio;
mod target;

pub use command::RenderOptions;
pub use error::RenderError;
pub use gallery::gallery;
pub use gif::Film;
pub use gif::encode as gif;
pub use mosaic::{Cell, Row, mosaic};
pub use show::Show;
pub use studio::{Studio, View};
