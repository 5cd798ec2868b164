//! `covers report`: tables, curves and the page from the folders of runs.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;

use crate::cli::{Threads, say};
use crate::error::CoversError;
use crate::events::write_events;
use crate::render::gallery;
use crate::runs::RunFolder;

use super::document::Report;
use super::png::Converter;
use super::run_data::{GroupFilm, RunData};

/// What to report.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Examples:\n  covers report runs/covers-seed* runs/equi-seed* --out report\n  \
    covers report runs/covers-seed0 --out report --films\n  \
    covers report runs/covers-seed0 --tensorboard boards"
)]
pub struct ReportOptions {
    /// The folders of runs, named METHOD-seedN as `covers sweep` names them; the first method is
    /// compared with the others.
    #[arg(required = true)]
    pub runs: Vec<PathBuf>,
    /// Folder for the tables (Markdown, CSV, LaTeX) and the curves (SVG); the tables are printed
    /// in any case.
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Put a GIF of each group's policies at work into `report.html`, some 10 kB each. Runs without
    /// checkpoints have none.
    #[arg(long, requires = "out")]
    pub films: bool,
    /// Draw the curves as PNG, too, by `rsvg-convert` (Debian's package librsvg2-bin).
    #[arg(long, requires = "out")]
    pub png: bool,
    /// Folder for TensorBoard's event files of the runs, finished or not, instead of the report.
    #[arg(long, value_name = "DIR", conflicts_with = "out")]
    pub tensorboard: Option<PathBuf>,
}

impl ReportOptions {
    /// Writes what was asked for and prints the tables to `out`.
    ///
    /// # Errors
    /// Runs that cannot be read or compared, files that cannot be written, or an `out` that cannot
    /// be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<(), CoversError> {
        if let Some(folder) = &self.tensorboard {
            let written = write_events(&self.runs, folder)?;
            let mut paths = written.iter().map(|path| path.display().to_string());
            return paths.try_for_each(|path| say(out, &path));
        }
        let folders = std::env::var_os("PATH").unwrap_or_default();
        let converter = self.png.then(|| Converter::find(&folders)).transpose()?;
        let runs = self.runs.iter().map(|run| RunData::read(run));
        let mut runs = runs.collect::<Result<Vec<_>, _>>()?;
        let mut films = Vec::new();
        if self.films {
            let own = self.runs.iter().zip(&mut runs);
            films = own
                .map(|(path, run)| film(path, run))
                .collect::<Result<_, _>>()?;
        }
        let report = Report::new(runs)?;
        let written = self.out.as_deref().map(|folder| report.write(folder));
        let curves = written.transpose()?.unwrap_or_default();
        say(out, report.markdown().trim_end())?;
        if let Some(converter) = converter {
            curves.iter().try_for_each(|svg| converter.convert(svg))?;
        }
        films.iter().try_for_each(|line| say(out, line))
    }
}

/// Films the policies of a run, and says how large the films are or why there are none.
fn film(path: &Path, run: &mut RunData) -> Result<String, CoversError> {
    let threads = Threads { threads: None }.count();
    match gallery(&RunFolder::open(path), threads) {
        Ok(films) => {
            let films = films.into_iter();
            run.films = films.map(|(group, gif)| GroupFilm { group, gif }).collect();
            let size: usize = run.films.iter().map(|film| film.gif.len()).sum();
            let (number, size) = (run.films.len(), size.div_ceil(1000));
            Ok(format!(
                "\n{}: {number} films, {size} kB in report.html",
                run.name
            ))
        }
        Err(CoversError::NoCheckpoint { problems, .. }) => {
            let name = &run.name;
            Ok(format!(
                "\n{name}: no films, for want of policies ({problems})"
            ))
        }
        Err(error) => Err(error),
    }
}
