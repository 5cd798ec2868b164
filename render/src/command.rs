//! `covers render`: films policies as a GIF or an mp4.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;
use clap::builder::RangedU64ValueParser;
use envs::TaskRegistry;
use symmetry::D2;

use experiments::cli::{ThreadCountOption, print_escaped, progress_bar};
use experiments::{RunData, RunFolder, thread_pool};

use super::error::RenderError;
use super::gif::Film;
use super::legend::outcome;
use super::output::OutputFile;
use super::player::{FilmSettings, FilmedEpisode, PolicyPlayer};
use super::recorder::FilmView;
use super::stream_film::film_stream;

/// Options of `covers render`: the groups, the views and the file of a film.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Examples:\n  \
    covers render runs/covers-sac-seed0 --view perspective --group drawer-close \
    --out policies.gif\n  \
    covers render runs/covers-sac-seed0 --stream --out stream.gif")]
pub struct RenderOptions {
    /// The folder of a run, or one that `covers pack` made.
    pub run: PathBuf,
    /// The file to create: a .gif, or, where `ffmpeg` is on the path, an .mp4.
    #[arg(long)]
    pub out: PathBuf,
    /// The four variants of this group alone, as `goal-reach` (default: all groups of the run).
    #[arg(long, visible_alias = "task")]
    pub group: Option<String>,
    /// Views of each variant, one row each; several are separated by commas.
    #[arg(long, visible_alias = "view", value_enum, value_delimiter = ',', default_value = "seen")]
    pub views: Vec<FilmView>,
    /// Below each row, show its pictures mirrored back: four times the same picture. Not for the
    /// view `perspective`.
    #[arg(long = "twins")]
    pub with_mirrored_twins: bool,
    /// End the film after this number of decisions (default: with the episode). The printed outcome
    /// is that of the whole episode.
    #[arg(long, value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub decisions: Option<usize>,
    /// Film the whole stream instead, in 12 seconds: the groups that came, the policies that served
    /// them, and success in training.
    #[arg(long, conflicts_with_all = ["group", "views", "with_mirrored_twins", "decisions", "seed"])]
    pub stream: bool,
    /// Seed of the placements, which the variants of a group share.
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    pub seed: u64,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub threads: ThreadCountOption,
}

impl RenderOptions {
    /// Films one episode of each variant, or the run's whole stream, to the output file, and prints
    /// the outcomes and the film's size to `out`.
    ///
    /// # Errors
    /// A group that the run was not trained on, mirrored pictures of the view from a corner, a
    /// folder without policies, a file that exists, has another extension or cannot be written;
    /// errors of the environments and the learner.
    pub fn run(&self, out: &mut impl Write) -> Result<(), RenderError> {
        if self.with_mirrored_twins && self.views.contains(&FilmView::Perspective) {
            return Err(RenderError::MirroredPerspective);
        }
        let target = OutputFile::new(&self.out)?;
        let folder = RunFolder::from_path(&self.run);
        let schedule = folder.read_experiment()?.schedule;
        let groups =
            schedule.resolve_group_or_all(self.group.as_deref(), &TaskRegistry::with_all())?;
        let threads = self.threads.count();
        let mut player = PolicyPlayer::load(&folder, threads)?;
        target.prepare()?;
        if self.stream {
            let (run, bar) = (RunData::read_partial(&self.run)?, progress_bar(0));
            let film = thread_pool(threads)?.install(|| film_stream(&mut player, &run, &bar))?;
            target.write(&film)?;
            return print_size(&film, &target, out);
        }
        let settings = FilmSettings {
            groups: &groups,
            views: &self.views,
            mirrored_back: self.with_mirrored_twins,
            decisions: self.decisions,
            seed: self.seed,
        };
        let bar = progress_bar(D2::ALL.len() * groups.len());
        let episodes = thread_pool(threads)?.install(|| player.play(&settings, &bar))?;
        bar.finish_and_clear();
        let film = player.compose(&settings, &episodes);
        // write before printing: a closed pipe must not lose the film
        target.write(&film)?;
        for episode in &episodes {
            print_escaped(out, &line(episode))?;
        }
        print_size(&film, &target, out)
    }
}

fn print_size(film: &Film, target: &OutputFile, out: &mut impl Write) -> Result<(), RenderError> {
    let (frames, path) = (film.frames.len(), target.path().display());
    let (width, height) = (film.width, film.height);
    let size = format!("{path}: {frames} pictures of {width} x {height} pixels");
    Ok(print_escaped(out, &size)?)
}

fn line(episode: &FilmedEpisode) -> String {
    let FilmedEpisode { variant, policy, success, .. } = episode;
    format!("{variant}: policy {policy}, {}", outcome(*success))
}
