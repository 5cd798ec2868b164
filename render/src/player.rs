//! Films of the variants of groups, played by the policies that the learner assigns to them.

use envs::{RGB_CHANNELS, TaskGroup, TaskRegistry, TaskVariant};
use rl::VectorEnv;
use symmetry::D2;

use experiments::cli::{ProgressBar, progress_bar};
use experiments::colours::curve_rgb;
use experiments::evaluation::Evaluator;
use experiments::{Experiment, RunError, RunFolder, SwitchableVecEnv, thread_pool};
use learner::{Learner, TaskLabel};

use super::gif::{Film, encode_gif};
use super::grid::{FilmGridCell, FilmGridRow, compose_film_grid};
use super::legend::{episode_caption, film_legend};
use super::recorder::{FilmView, SingleEpisodeFilmEnv};

/// Length, in decisions, of a film of [`film_groups_to_gifs`]: three seconds of simulated time.
const DECISIONS: usize = 24;

/// Settings of films of policies: groups, views, length and seed.
pub(super) struct FilmSettings<'a> {
    pub groups: &'a [TaskGroup],
    pub views: &'a [FilmView],
    /// `true` if each row is repeated, with pictures mirrored back to the first variant's frame.
    pub mirrored_back: bool,
    /// Decisions after which a film ends; `None` for the whole episode.
    pub decisions: Option<usize>,
    /// Seed of placements, which the variants of a group share.
    pub seed: u64,
}

/// Filmed episode of a task variant.
pub(super) struct FilmedEpisode {
    pub variant: TaskVariant,
    pub policy: usize,
    pub success: bool,
    /// `true` if the policy observes the goal as numbers, so that pictures mark it.
    pub shows_goal: bool,
    /// Films of the episode, one for each view.
    pub cells: Vec<FilmGridCell>,
}

/// Policies of a run, with the environments in which they are evaluated and filmed.
pub struct PolicyPlayer {
    /// Settings of the run.
    pub experiment: Experiment,
    learner: Box<dyn Learner>,
    evaluator: Evaluator,
}

impl PolicyPlayer {
    /// Loads the policies of the newest intact checkpoint in `folder`.
    ///
    /// # Errors
    /// As [`RunFolder::read_experiment`], [`RunFolder::verify_robot`] and
    /// [`RunFolder::load_learner`].
    pub fn load(folder: &RunFolder, threads: usize) -> Result<Self, RunError> {
        let experiment = folder.read_experiment()?.with_threads(threads);
        folder.verify_robot(&experiment)?;
        let (spec, labels) = (SwitchableVecEnv::env_spec(&experiment.envs), TaskLabel::default());
        let learner = folder.load_learner(&experiment.learner, &spec, &labels)?;
        let evaluator = Evaluator::for_experiment(&experiment, &TaskRegistry::with_all(), labels)?;
        Ok(Self { experiment, learner, evaluator })
    }

    /// Films one episode of each variant of the groups; each advances the progress bar by a step.
    ///
    /// # Errors
    /// Errors of the environments and the learner.
    pub(super) fn play(
        &mut self,
        settings: &FilmSettings<'_>,
        bar: &ProgressBar,
    ) -> Result<Vec<FilmedEpisode>, RunError> {
        let variants = settings.groups.iter().flat_map(|group| group.variants());
        let films = variants.map(|variant| self.film(variant, settings));
        films.inspect(|_| bar.inc(1)).collect()
    }

    /// Films one episode of a task variant, played by the policy that the learner chooses.
    ///
    /// # Errors
    /// Errors of the environments and the learner.
    pub(super) fn film(
        &mut self,
        variant: TaskVariant,
        settings: &FilmSettings<'_>,
    ) -> Result<FilmedEpisode, RunError> {
        let FilmSettings { views, decisions, seed, .. } = *settings;
        let mut recorder = SingleEpisodeFilmEnv::new(&self.experiment.envs, variant, views, seed)?;
        let (policy, success) = self.play_episode(variant, &mut recorder)?;
        let mut cells = recorder.films_of_views(views, decisions);
        for cell in &mut cells {
            cell.caption = Some(episode_caption(policy, success));
        }
        let shows_goal = recorder.environment().observable_goal().is_some();
        Ok(FilmedEpisode { variant, policy, success, shows_goal, cells })
    }

    /// Lets the learner choose a policy for `variant` and plays one episode of it in `env`, a
    /// vector of one environment. Returns the policy's index, and `true` if the episode succeeded.
    ///
    /// # Errors
    /// Errors of the environments and the learner.
    pub fn play_episode(
        &mut self,
        variant: TaskVariant,
        env: &mut dyn VectorEnv,
    ) -> Result<(usize, bool), RunError> {
        let policy = self.evaluator.recognise_policy(&mut *self.learner, variant)?.policy;
        let stats = self.learner.evaluate_policy(policy, env, 1)?.stats;
        Ok((policy, stats.success_rate() == Some(1.0)))
    }

    /// Returns the colour that reports use for a group, by its place in the run's schedule.
    fn colour(&self, group: TaskGroup) -> [u8; 3] {
        let schedule = &self.experiment.schedule;
        let number = schedule.group_index(group.name());
        curve_rgb(number.unwrap_or(schedule.groups.len()))
    }

    /// Composes the film of these episodes: a column for each variant, and a legend.
    pub(super) fn compose(&self, settings: &FilmSettings<'_>, episodes: &[FilmedEpisode]) -> Film {
        let names = D2::ALL.map(|element| element.to_string());
        let columns = names.each_ref().map(String::as_str);
        let FilmSettings { views, mirrored_back, .. } = *settings;
        let shows_goal = episodes.iter().any(|episode| episode.shows_goal);
        let legend = film_legend(&self.experiment, views, mirrored_back, shows_goal);
        compose_film_grid(&columns, &self.rows(settings, episodes), &legend)
    }

    /// Returns the rows of a grid: the variants of a group side by side, one row for each view, and
    /// a second one with pictures mirrored back if the settings ask for it.
    fn rows(&self, settings: &FilmSettings<'_>, episodes: &[FilmedEpisode]) -> Vec<FilmGridRow> {
        let row = |group: TaskGroup, view: usize, mirrored_back: bool| {
            let of_group = episodes.iter().filter(|episode| episode.variant.group == group);
            let cells = of_group.map(|episode| {
                let cell = &episode.cells[view];
                if mirrored_back { mirrored(cell, episode.variant.element) } else { cell.clone() }
            });
            FilmGridRow {
                title: title(group, settings.views, view, mirrored_back),
                colour: self.colour(group),
                cells: cells.collect(),
            }
        };
        let mut rows = Vec::new();
        for &group in settings.groups {
            for view in 0..settings.views.len() {
                rows.push(row(group, view, false));
                rows.extend(settings.mirrored_back.then(|| row(group, view, true)));
            }
        }
        rows
    }
}

/// Films one episode of each variant of every task group of a run, with the policies of the newest
/// intact checkpoint. Returns each group's name with a GIF file of its four variants as the
/// policies see them.
///
/// # Errors
/// A folder without policies; errors of the environments and the learner.
pub fn film_groups_to_gifs(
    folder: &RunFolder,
    threads: usize,
) -> Result<Vec<(String, Vec<u8>)>, RunError> {
    let groups = folder.read_experiment()?.schedule.resolve_groups(&TaskRegistry::with_all())?;
    let mut player = PolicyPlayer::load(folder, threads)?;
    let pool = thread_pool(threads)?;
    let bar = progress_bar(D2::ALL.len() * groups.len());
    let films = groups.into_iter().map(|group| {
        let settings = FilmSettings {
            groups: &[group],
            views: &[FilmView::PolicyInput],
            mirrored_back: false,
            decisions: Some(DECISIONS),
            seed: 0,
        };
        let episodes = pool.install(|| player.play(&settings, &bar))?;
        let gif = encode_gif(&player.compose(&settings, &episodes))
            .map_err(RunError::write_error_mapper(folder.path()))?;
        Ok((group.name().to_owned(), gif))
    });
    films.collect()
}

fn title(group: TaskGroup, views: &[FilmView], view: usize, mirrored_back: bool) -> String {
    let shown = match (views.len(), views[view]) {
        (1, _) => "",
        (_, FilmView::Raw) => ": what a camera sees",
        (_, FilmView::Mask) => ": where the arm is",
        (_, FilmView::Perspective) => ": from a corner",
        (_, FilmView::PolicyInput) => ": what the policy sees",
    };
    let back = if mirrored_back { ", mirrored back" } else { "" };
    format!("{group}{shown}{back}")
}

/// Transforms every picture of a film by `element`. Elements of D2 are their own inverses, so this
/// mirrors a variant's film back.
fn mirrored(cell: &FilmGridCell, element: D2) -> FilmGridCell {
    let FilmGridCell { width, height, .. } = *cell;
    let frames = cell.frames.iter();
    let frames = frames.map(|frame| element.transform_image(frame, height, width, RGB_CHANNELS));
    FilmGridCell { frames: frames.collect(), caption: cell.caption.clone(), ..*cell }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_film_is_mirrored_as_its_variant_is() {
        let cell = FilmGridCell {
            width: 2,
            height: 2,
            frames: vec![(0..12).collect(), (12..24).collect()],
            caption: None,
        };
        let first = |element| mirrored(&cell, element).frames[0].clone();
        assert_eq!(first(D2::Identity), cell.frames[0]);
        assert_eq!(first(D2::FlipX), [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]);
        assert_eq!(first(D2::FlipY), [6, 7, 8, 9, 10, 11, 0, 1, 2, 3, 4, 5]);
        let twice = |element| mirrored(&mirrored(&cell, element), element);
        assert!(D2::ALL.into_iter().all(|element| twice(element) == cell));
    }
}
