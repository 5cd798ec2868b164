//! Variants of groups on film, played by the policies that the learner itself recognises.

use envs::{RGB, TaskGroup, TaskRegistry, TaskVariant};
use rl::VectorEnv;
use symmetry::D2;

use experiments::colours::rgb;
use experiments::evaluation::Evaluator;
use experiments::{Experiment, RunError, RunFolder, Stream};
use learner::{Labels, Learner};

use super::mosaic::{Cell, Row};
use super::studio::{Studio, View};

/// What is filmed.
pub(super) struct Shot<'a> {
    pub groups: &'a [TaskGroup],
    pub views: &'a [View],
    /// Whether each row comes a second time, mirrored back.
    pub twins: bool,
    /// Decisions after which a film ends; without a number, the episode's.
    pub decisions: Option<usize>,
    pub seed: u64,
}

/// What became of a variant.
pub(super) struct Played {
    pub variant: TaskVariant,
    pub policy: usize,
    pub success: bool,
    /// One for each view.
    cells: Vec<Cell>,
}

/// Policies, and the environments in which they recognise their groups.
pub struct Show {
    /// The settings of their run.
    pub experiment: Experiment,
    learner: Box<dyn Learner>,
    evaluator: Evaluator,
}

impl Show {
    /// The policies of the newest intact checkpoint in `folder`.
    ///
    /// # Errors
    /// As [`RunFolder::experiment`] and [`RunFolder::load_learner`].
    pub fn load(folder: &RunFolder, threads: usize) -> Result<Self, RunError> {
        let experiment = folder.experiment()?.with_threads(threads);
        let (spec, labels) = (Stream::spec_of(&experiment.envs), Labels::default());
        let learner = folder.load_learner(&experiment.learner, &spec, &labels)?;
        let evaluator = Evaluator::of(&experiment, &TaskRegistry::standard(), labels)?;
        Ok(Self { experiment, learner, evaluator })
    }

    /// Plays the variants of a shot, one episode each.
    ///
    /// # Errors
    /// What the environments or the learner say.
    pub(super) fn play(&mut self, shot: &Shot<'_>) -> Result<Vec<Played>, RunError> {
        let variants = shot.groups.iter().flat_map(|group| group.variants());
        variants.map(|variant| self.variant(variant, shot)).collect()
    }

    fn variant(&mut self, variant: TaskVariant, shot: &Shot<'_>) -> Result<Played, RunError> {
        let envs = &self.experiment.envs;
        let mut studio = Studio::new(envs, variant, shot.views, shot.seed)?;
        let (policy, success) = self.perform(variant, &mut studio)?;
        Ok(Played { variant, policy, success, cells: studio.cells(shot.views, shot.decisions) })
    }

    /// Plays one episode of `stage`, an environment of one that shows `variant`; returns the policy
    /// that the learner recognised, and whether it succeeded.
    ///
    /// # Errors
    /// What the environments or the learner say.
    pub fn perform(
        &mut self,
        variant: TaskVariant,
        stage: &mut dyn VectorEnv,
    ) -> Result<(usize, bool), RunError> {
        let policy = self.evaluator.recognise(&mut *self.learner, variant)?;
        let stats = self.learner.perform(policy, stage, 1)?.stats;
        Ok((policy, stats.success_rate() == Some(1.0)))
    }

    /// Where the group stands among those of the run, which says its colour.
    fn colour(&self, group: TaskGroup) -> [u8; 3] {
        let schedule = &self.experiment.schedule;
        let number = schedule.number(group.name());
        rgb(number.unwrap_or(schedule.groups.len()))
    }

    /// Rows of a mosaic: a group's variants beside each other, one row for each view, and one more
    /// for twins.
    pub(super) fn rows(&self, shot: &Shot<'_>, played: &[Played]) -> Vec<Row> {
        let row = |group: TaskGroup, view: usize, twin: bool| {
            let of_group = played.iter().filter(|played| played.variant.group == group);
            let cells = of_group.map(|played| match twin {
                true => mirrored(&played.cells[view], played.variant.element),
                false => played.cells[view].clone(),
            });
            Row {
                title: title(group, shot.views, view, twin),
                colour: self.colour(group),
                cells: cells.collect(),
            }
        };
        let mut rows = Vec::new();
        for &group in shot.groups {
            for view in 0..shot.views.len() {
                rows.push(row(group, view, false));
                rows.extend(shot.twins.then(|| row(group, view, true)));
            }
        }
        rows
    }
}

fn title(group: TaskGroup, views: &[View], view: usize, twin: bool) -> String {
    let shown = match (views.len(), views[view]) {
        (1, _) => "",
        (_, View::Raw) => ": what a camera sees",
        (_, View::Mask) => ": where the arm is",
        (_, View::Seen) => ": what the policy sees",
    };
    let back = if twin { ", mirrored back" } else { "" };
    format!("{group}{shown}{back}")
}

/// The film as `element` moves it, which is its own inverse.
fn mirrored(cell: &Cell, element: D2) -> Cell {
    let frames = cell.frames.iter().map(|frame| {
        let mut rows: Vec<&[u8]> = frame.chunks_exact(cell.width * RGB).collect();
        if element.flips_y() {
            rows.reverse();
        }
        let turned = rows.into_iter().flat_map(|row| {
            let mut pixels: Vec<&[u8]> = row.chunks_exact(RGB).collect();
            if element.flips_x() {
                pixels.reverse();
            }
            pixels.concat()
        });
        turned.collect()
    });
    Cell { frames: frames.collect(), ..*cell }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_film_is_mirrored_as_its_variant_is() {
        let cell =
            Cell { width: 2, height: 2, frames: vec![(0..12).collect(), (12..24).collect()] };
        let first = |element| mirrored(&cell, element).frames[0].clone();
        assert_eq!(first(D2::Identity), cell.frames[0]);
        assert_eq!(first(D2::FlipX), [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]);
        assert_eq!(first(D2::FlipY), [6, 7, 8, 9, 10, 11, 0, 1, 2, 3, 4, 5]);
        let twice = |element| mirrored(&mirrored(&cell, element), element);
        assert!(D2::ALL.into_iter().all(|element| twice(element) == cell));
    }
}
