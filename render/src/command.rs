//! `covers render`: policies at work, as a GIF or an mp4.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;
use clap::builder::RangedU64ValueParser;
use envs::TaskRegistry;
use symmetry::D2;

use experiments::cli::{Threads, say};
use experiments::{RunFolder, thread_pool};

use super::error::RenderError;
use super::mosaic::mosaic;
use super::show::{Played, Shot, Show};
use super::studio::View;
use super::target::Target;

/// What to film.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Example: covers render runs/covers-seed0 --views raw --out policies.gif")]
pub struct RenderOptions {
    /// The folder of a run, or one that `covers pack` made.
    pub run: PathBuf,
    /// The file to create: a .gif, or, where `ffmpeg` is on the path, an .mp4.
    #[arg(long)]
    pub out: PathBuf,
    /// The four variants of this group alone, as `goal-reach` (default: all groups of the run).
    #[arg(long, visible_alias = "task")]
    pub group: Option<String>,
    /// What is shown of each variant, one row each; several are parted by commas.
    #[arg(long, value_enum, value_delimiter = ',', default_value = "seen")]
    pub views: Vec<View>,
    /// Below each row, show its pictures mirrored back: four times the same.
    #[arg(long)]
    pub twins: bool,
    /// End the film after so many decisions (default: with the episode); whether a variant was
    /// solved is said of the whole episode.
    #[arg(long, value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub decisions: Option<usize>,
    /// Seed of the placements, which the variants of a group share.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub threads: Threads,
}

impl RenderOptions {
    /// Plays one episode of each variant, writes the film and prints to `out`.
    ///
    /// # Errors
    /// A group that the run has not learnt, a folder without policies, a file that exists, has
    /// another ending or cannot be written; what the environments or the learner say.
    pub fn run(&self, out: &mut impl Write) -> Result<(), RenderError> {
        let target = Target::new(&self.out)?;
        let folder = RunFolder::open(&self.run);
        let schedule = folder.experiment()?.schedule;
        let groups = schedule.chosen(self.group.as_deref(), &TaskRegistry::standard())?;
        let threads = self.threads.count();
        let mut show = Show::load(&folder, threads)?;
        target.prepare()?;
        let shot = Shot {
            groups: &groups,
            views: &self.views,
            twins: self.twins,
            decisions: self.decisions,
            seed: self.seed,
        };
        let played = thread_pool(threads)?.install(|| show.play(&shot))?;
        let names = D2::ALL.map(|element| element.to_string());
        let film = mosaic(&names.each_ref().map(String::as_str), &show.rows(&shot, &played));
        // a closed pipe loses no film
        target.write(&film)?;
        for played in &played {
            say(out, &line(played))?;
        }
        let (frames, path) = (film.frames.len(), target.path().display());
        let (width, height) = (film.width, film.height);
        let size = format!("{path}: {frames} pictures of {width} x {height} pixels");
        Ok(say(out, &size)?)
    }
}

fn line(played: &Played) -> String {
    let outcome = if played.success { "solved" } else { "not solved" };
    let Played { variant, policy, .. } = played;
    format!("{variant}: policy {policy}, {outcome}")
}
