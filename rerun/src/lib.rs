//! Recordings of a run and its policies for the [Rerun](https://rerun.io) viewer. The crate is a
//! workspace of its own, since the viewer's SDK has more dependencies than the whole project.

mod blueprint;
mod episode;
mod recording;
mod scene;
mod stream;

use std::io::Write;
use std::path::PathBuf;

use clap::Parser;
use covers::experiments::cli::{ThreadCountOption, print_escaped};
use covers::experiments::new_file::NewOutputFile;
use covers::experiments::thread_pool;
use covers::render::{PolicyPlayer, RenderError};
use covers::{CoversError, RunData, RunFolder};
use envs::TaskRegistry;

use crate::recording::Recording;

/// Records a run and its policies at work for the Rerun viewer.
#[derive(Clone, Debug, Parser)]
#[command(version, after_help = "Example: covers-rerun runs/covers-sac-seed0 --out covers.rrd")]
pub struct RerunOptions {
    /// The folder of a run, or one that `covers pack` made.
    pub run: PathBuf,
    /// The file to create, a name with the ending .rrd.
    #[arg(long)]
    pub out: PathBuf,
    /// The four variants of this group alone, as `goal-reach` (default: all groups of the run).
    #[arg(long, visible_alias = "task")]
    pub group: Option<String>,
    /// Seed of the placements, which the variants of a group share.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub threads: ThreadCountOption,
}

impl RerunOptions {
    /// Writes a recording for the Rerun viewer to the file `self.out`, with the stream from the
    /// run's tables and one episode of each variant, and prints the episodes' outcomes to `out`.
    ///
    /// # Errors
    /// A group that is not in the run's schedule, a folder without policies, a file that exists,
    /// has another extension or cannot be written, and errors of the environments and the learner.
    pub fn run(&self, out: &mut impl Write) -> Result<(), CoversError> {
        let path = &self.out;
        if path.extension().is_none_or(|ending| ending != "rrd") {
            let expected = ".rrd";
            return Err(RenderError::UnsupportedExtension { path: path.clone(), expected }.into());
        }
        let file = NewOutputFile::new(path)?;
        file.prepare_folder()?;
        let run = RunData::read_partial(&self.run)?;
        let schedule = &run.experiment.schedule;
        let groups =
            schedule.resolve_group_or_all(self.group.as_deref(), &TaskRegistry::with_all())?;
        let threads = self.threads.count();
        let mut show = PolicyPlayer::load(&RunFolder::from_path(&self.run), threads)?;
        let recording = Recording::new(path, &run.name, blueprint::of(&run, &groups))?;
        stream::record(&run, &recording)?;
        let pool = thread_pool(threads)?;
        let variants = groups.iter().flat_map(|group| group.variants());
        let record = |variant| episode::record(variant, self.seed, &mut show, &recording);
        let played = pool.install(|| variants.map(record).collect::<Result<Vec<_>, _>>())?;
        file.write(&recording.into_bytes()?)?;
        // the file is written first, so that a closed pipe loses no recording
        let hint = "`rerun FILE` opens it; episodes play on the timeline `decision`";
        let lines = played.into_iter().chain([format!("{}: {hint}", path.display())]);
        for line in lines {
            print_escaped(out, &line)?;
        }
        Ok(())
    }
}
