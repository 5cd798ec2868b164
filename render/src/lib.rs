//! Films of trained policies: GIF, and mp4 where `ffmpeg` is on the path.

mod canvas;
mod command;
mod error;
mod font;
mod gif;
mod grid;
mod legend;
mod mp4;
mod output;
mod palette;
mod player;
mod recorder;
mod stream_film;

pub use command::RenderOptions;
pub use error::RenderError;
pub use gif::{Film, encode_gif};
pub use grid::{FilmCaption, FilmGridCell, FilmGridRow, FilmLegendEntry, compose_film_grid};
pub use player::{PolicyPlayer, film_groups_to_gifs};
pub use recorder::{FilmView, SingleEpisodeFilmEnv};
