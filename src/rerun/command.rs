//! `covers rerun`: what is recorded, and where.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;

use crate::cli::Threads;
use crate::error::CoversError;

/// What to record.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Example: covers rerun runs/covers-seed0 --out covers.rrd")]
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
    pub threads: Threads,
}

impl RerunOptions {
    /// Records the stream as the run's tables tell it and one episode of each variant, and prints
    /// to `out`.
    ///
    /// # Errors
    /// A program that was built without the feature `rerun`; a group that the run has not learnt, a
    /// folder without policies, a file that exists, has another ending or cannot be written; what
    /// the environments or the learner say.
    #[cfg(feature = "rerun")]
    pub fn run(&self, out: &mut impl Write) -> Result<(), CoversError> {
        use envs::TaskRegistry;

        use crate::cli::say;
        use crate::new_file::{NewFile, ending};
        use crate::render::Show;
        use crate::report::RunData;
        use crate::runs::{RunFolder, thread_pool};

        use super::recording::Recording;
        use super::{blueprint, episode, stream};

        let path = &self.out;
        if ending(path).as_deref() != Some("rrd") {
            return Err(CoversError::Ending {
                path: path.clone(),
                expected: ".rrd",
            });
        }
        let file = NewFile::new(path)?;
        let run = RunData::so_far(&self.run)?;
        let schedule = &run.experiment.schedule;
        let groups = schedule.chosen(self.group.as_deref(), &TaskRegistry::standard())?;
        let threads = self.threads.count();
        let mut show = Show::load(&RunFolder::open(&self.run), threads)?;
        file.prepare()?;
        let recording = Recording::new(path, &run.name, blueprint::of(&run, &groups))?;
        stream::record(&run, &recording)?;
        let pool = thread_pool(threads)?;
        let variants = groups.iter().flat_map(|group| group.variants());
        let record = |variant| episode::record(variant, self.seed, &mut show, &recording);
        let played = pool.install(|| variants.map(record).collect::<Result<Vec<_>, _>>())?;
        // a closed pipe loses no recording
        file.write(&recording.finish()?)?;
        played.iter().try_for_each(|line| say(out, line))?;
        let hint = "`rerun FILE` opens it; episodes play on the timeline `decision`";
        say(out, &format!("{}: {hint}", path.display()))
    }

    /// Refuses: recordings take the feature `rerun`.
    ///
    /// # Errors
    /// [`CoversError::NoRerun`].
    #[cfg(not(feature = "rerun"))]
    pub fn run(&self, _: &mut impl Write) -> Result<(), CoversError> {
        Err(CoversError::NoRerun)
    }
}
