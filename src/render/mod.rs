//! Moving pictures of policies: GIF, and mp4 where `ffmpeg` is on the path.

mod command;
mod film;
mod font;
mod gallery;
mod gif;
mod mosaic;
mod mp4;
mod palette;
mod show;
mod studio;
mod target;

pub use command::RenderOptions;
pub use film::Film;
pub(crate) use gallery::gallery;
pub(crate) use gif::encode as gif;
pub(crate) use mosaic::{Cell, Row, mosaic};
pub use show::Show;
pub use studio::{Studio, View};
