//! Command `covers report`: tables, curves and the page from the folders of runs.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;

use crate::events::write_tensorboard_events;
use experiments::cli::{ThreadCountOption, print_escaped};
use experiments::{GroupFilm, RunData, RunError, RunFolder};
use render::film_groups_to_gifs;
use symmetry::D2;

use super::error::ReportError;
use super::method::MethodRuns;
use super::report::Report;

/// Options of `covers report`.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Examples:\n  covers report runs/covers-seed* runs/equi-seed* --out report\n  \
    covers report runs/covers-sac-seed0 --out report --films\n  \
    covers report runs/covers-sac-seed0 --tensorboard boards"
)]
pub struct ReportOptions {
    /// The folders of runs, finished or not, named METHOD-seedN as `covers sweep` names them; the
    /// first method is compared with the others.
    #[arg(required = true)]
    pub runs: Vec<PathBuf>,
    /// Folder for the tables (Markdown, CSV, LaTeX) and the curves (SVG), of its own: drawings in
    /// it that are named as those of a report are replaced or removed. The tables are printed in
    /// any case.
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Put a GIF of each group's policies at work into `report.html`, some 20 kB each. Runs without
    /// checkpoints have none.
    // `requires` alone does not hold beside `tensorboard`, with which `out` conflicts
    #[arg(long, requires = "out", conflicts_with = "tensorboard")]
    pub films: bool,
    /// Folder for TensorBoard's event files of the runs, finished or not, instead of the report.
    #[arg(long, value_name = "DIR", conflicts_with = "out")]
    pub tensorboard: Option<PathBuf>,
}

impl ReportOptions {
    /// Prints the report's tables to `out`, and writes its files if a folder is given; or writes
    /// TensorBoard events instead.
    ///
    /// # Errors
    /// Runs that cannot be read or compared, files that cannot be written, or an `out` that cannot
    /// be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<(), ReportError> {
        if let Some(folder) = &self.tensorboard {
            let written = write_tensorboard_events(&self.runs, folder)?;
            let mut paths = written.iter().map(|path| path.display().to_string());
            return Ok(paths.try_for_each(|path| print_escaped(out, &path))?);
        }
        let runs = self.runs.iter().map(|run| read_run(run));
        let mut runs = runs.collect::<Result<Vec<_>, _>>()?;
        let mut film_lines = Vec::new();
        if self.films {
            // films take minutes, which runs that do not compare would waste
            MethodRuns::group_by_method(runs.clone())?;
            let runs_with_paths = self.runs.iter().zip(&mut runs);
            film_lines =
                runs_with_paths.map(|(path, run)| film(path, run)).collect::<Result<_, _>>()?;
        }
        let report = Report::new(runs)?;
        // the files come first: a closed standard output must not cost the report
        if let Some(folder) = &self.out {
            report.write(folder)?;
        }
        print_escaped(out, report.markdown().trim_end())?;
        film_lines.iter().try_for_each(|line| print_escaped(out, line))?;
        if let Some(folder) = &self.out {
            print_escaped(out, &format!("\npage: {}", folder.join("report.html").display()))?;
        }
        Ok(())
    }
}

/// Reads a run's folder. Of a run in progress, evaluations that lack variants are left out.
fn read_run(path: &Path) -> Result<RunData, RunError> {
    let folder = RunFolder::from_path(path);
    let experiment = folder.read_experiment()?;
    if folder.is_finished() {
        return RunData::read(path);
    }
    if folder.is_packed() {
        return Err(RunError::PackedRun { folder: path.to_owned() });
    }
    let mut run = RunData::read_partial(path)?;
    let variants = D2::ALL.len() * experiment.schedule.groups.len();
    if run.last_scores().count() < variants {
        let last = run.scores.last().map(|row| row.rollouts);
        run.scores.retain(|row| Some(row.rollouts) != last);
    }
    Ok(run)
}

/// Renders the policies of a run into `run.films`. Returns a line on their size, or the reason why
/// there are none.
fn film(path: &Path, run: &mut RunData) -> Result<String, RunError> {
    let threads = ThreadCountOption { threads: None }.count();
    match film_groups_to_gifs(&RunFolder::from_path(path), threads) {
        Ok(films) => {
            run.films = films.into_iter().map(|(group, gif)| GroupFilm { group, gif }).collect();
            let size: usize = run.films.iter().map(|film| film.gif.len()).sum();
            let (number, size) = (run.films.len(), size.div_ceil(1000));
            Ok(format!("\n{}: {number} films, {size} kB in report.html", run.name))
        }
        // a report on runs without checkpoints is complete but for the films
        Err(error @ (RunError::NoCheckpoint { .. } | RunError::WithoutCheckpoints { .. })) => {
            Ok(format!("\n{}: no films ({error})", run.name))
        }
        Err(error) => Err(error),
    }
}
