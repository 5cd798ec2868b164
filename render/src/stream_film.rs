//! Film of a whole stream: the group that runs, the policy that serves it, and success so far.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::ops::Range;

use envs::{TaskRegistry, TaskVariant};
use symmetry::D2;

use experiments::cli::ProgressBar;
use experiments::colours::curve_rgb;
use experiments::evaluation::mean;
use experiments::{RolloutRow, RunData, RunError};

use super::canvas::Canvas;
use super::font::LINE_HEIGHT;
use super::gif::Film;
use super::grid::{FilmCaption, INK};
use super::legend::episode_caption;
use super::player::{FilmSettings, PolicyPlayer};
use super::recorder::{FilmView, PERSPECTIVE_SIZE};

/// Approximate number of pictures of the film: 12 seconds.
const PICTURES: usize = 150;
/// Decisions of an episode that a visit shows: the policies need about half of it.
const DECISIONS: usize = 36;
/// Margin of the film and gap between its parts (pixels).
const GAP: usize = 12;
/// Height of a line of the legend (pixels).
const LEGEND_LINE: usize = LINE_HEIGHT + 4;
/// Legend of the film, line by line.
const LEGEND: [&str; 2] = [
    "Strip: the groups of the stream. Lines: success in training, the mean of 5 rollouts.",
    "The learner is told neither the group nor the variant.",
];
/// Top of the view of the table and of the policies (pixels).
const TOP: usize = 2 * GAP + LINE_HEIGHT;
/// Width of the column of policies (pixels).
const POLICIES: usize = 300;
/// Largest height of a policy's box (pixels).
const BOX: usize = 56;
/// Height of the strip of groups, and of the curves below it (pixels).
const STRIP: [usize; 2] = [8, 84];
/// Space for the labels left of the curves (pixels).
const LABELS: usize = 18;
/// Rollouts over which the curves of success are averaged.
const WINDOW: usize = 5;
/// Share of a policy's colour in its box while another policy acts.
const RESTING: f32 = 0.12;
const WHITE: [u8; 3] = [255; 3];

/// Films the stream of a run: each visit to a group as one episode, played with the final policies,
/// beside the rollouts that the run recorded. Every visit takes equally long and shows an episode
/// of the group, with the policy that the learner chooses after the stream; visits take turns in
/// showing the group's variants.
///
/// # Errors
/// A run without rollouts or with a group that is not registered; errors of the environments and
/// the learner.
pub(super) fn film_stream(
    player: &mut PolicyPlayer,
    run: &RunData,
    bar: &ProgressBar,
) -> Result<Film, RunError> {
    let visits = visits(&run.rollouts);
    if visits.is_empty() {
        let problem = "it has no rollouts yet".to_owned();
        return Err(RunError::UnreportableRun { folder: run.name.clone().into(), problem });
    }
    let groups = player.experiment.schedule.resolve_groups(&TaskRegistry::with_all())?;
    let per_visit = (PICTURES / visits.len()).max(1);
    bar.set_length(visits.len() as u64);
    let mut clips = HashMap::new();
    let mut film = Film::default();
    for (number, visit) in visits.into_iter().enumerate() {
        let name = &run.rollouts[visit.start].group;
        let known = groups.iter().find(|group| group.name() == name);
        let group = *known.ok_or_else(|| RunError::UnreportableRun {
            folder: run.name.clone().into(),
            problem: format!("its group {name} is not in its settings"),
        })?;
        let element = D2::ALL[number % D2::ALL.len()];
        let variant = TaskVariant { group, element };
        let clip = match clips.entry((name, element.to_string())) {
            Entry::Occupied(taken) => taken.into_mut(),
            Entry::Vacant(new) => new.insert(Clip::film(player, variant)?),
        };
        for picture in 0..per_visit {
            let newest = visit.start + (picture + 1) * visit.len() / per_visit;
            let newest = newest.clamp(visit.start + 1, visit.end) - 1;
            let canvas = draw(run, newest, visit.start, clip, picture * clip.last() / per_visit);
            (film.width, film.height) = (canvas.width, canvas.height);
            film.frames.push(canvas.rgb);
        }
        bar.inc(1);
    }
    Ok(film)
}

/// Returns the rollouts of each visit of the stream to a group.
fn visits(rollouts: &[RolloutRow]) -> Vec<Range<usize>> {
    let mut start = 0;
    let chunks = rollouts.chunk_by(|one, next| one.group == next.group);
    chunks
        .map(|chunk| {
            start += chunk.len();
            start - chunk.len()..start
        })
        .collect()
}

/// Filmed episode of a variant.
struct Clip {
    title: String,
    caption: FilmCaption,
    /// Pictures of the episode; at least one.
    frames: Vec<Vec<u8>>,
}

impl Clip {
    /// Films an episode with the policy that the learner chooses after the stream.
    fn film(player: &mut PolicyPlayer, variant: TaskVariant) -> Result<Self, RunError> {
        let settings = FilmSettings {
            groups: &[variant.group],
            views: &[FilmView::Perspective],
            mirrored_back: false,
            decisions: Some(DECISIONS),
            seed: 0,
        };
        let mut episode = player.film(variant, &settings)?;
        let mut caption = episode_caption(episode.policy, episode.success);
        caption.text += " (an episode after training)";
        Ok(Self {
            title: format!("{}, {}", variant.group, variant.element),
            caption,
            frames: episode.cells.remove(0).frames,
        })
    }

    /// Returns the index of the last picture.
    fn last(&self) -> usize {
        self.frames.len() - 1
    }
}

/// Draws the film's picture after the rollout with index `newest`, of a visit from rollout `start`
/// on, with this picture of a clip.
fn draw(run: &RunData, newest: usize, start: usize, clip: &Clip, picture: usize) -> Canvas {
    let [width, height] = PERSPECTIVE_SIZE;
    let curves = TOP + height + LEGEND_LINE + 3 * GAP + STRIP[0] + STRIP[1];
    let mut canvas =
        Canvas::new(3 * GAP + width + POLICIES, curves + LEGEND.len() * LEGEND_LINE + GAP / 2);
    let row = &run.rollouts[newest];
    canvas.draw_text(&clip.title, [GAP, GAP], colour(run, &row.group));
    canvas.draw_enlarged_picture(&clip.frames[picture], width, 1, [GAP, TOP]);
    canvas.draw_text(&clip.caption.text, [GAP, TOP + height + 2], clip.caption.colour);
    let heading = format!("policies after {} decisions", row.decisions);
    canvas.draw_text(&heading, [2 * GAP + width, GAP], INK);
    draw_policies(&mut canvas, run, newest, start);
    draw_curves(&mut canvas, run, newest);
    for (number, line) in LEGEND.iter().enumerate() {
        canvas.draw_text(line, [GAP, curves + number * LEGEND_LINE], INK);
    }
    canvas
}

/// Draws a box for each policy that exists; that of the policy that serves the rollout is lit.
fn draw_policies(canvas: &mut Canvas, run: &RunData, newest: usize, start: usize) {
    let [width, height] = PERSPECTIVE_SIZE;
    let most = run.policy_count().max(1);
    let pitch = (height / most).clamp(1, BOX + GAP);
    let gap = if pitch < 2 * LINE_HEIGHT { 1 } else { GAP / 2 };
    let exist = run.rollouts[..=newest].iter().map(|row| row.policy + 1).max().unwrap_or(0);
    let active = run.rollouts[newest].policy;
    // the first policy exists from the start, so no rollout creates it
    let is_new = run.rollouts[..start].iter().all(|row| row.policy != active);
    for policy in 0..exist {
        let group = run.group_of_policy(policy).unwrap_or("");
        let corner = [2 * GAP + width, TOP + policy * pitch];
        let size = [POLICIES, pitch.saturating_sub(gap)];
        let is_active = policy == active;
        canvas.blend_rectangle(
            corner,
            size,
            colour(run, group),
            if is_active { 1.0 } else { RESTING },
        );
        let state = match (is_active, is_new) {
            (false, _) => "",
            (true, true) => ", new",
            (true, false) => ", recalled",
        };
        let ink = if is_active { WHITE } else { INK };
        let text = [corner[0] + GAP, (corner[1] + size[1] / 2).saturating_sub(LINE_HEIGHT / 2)];
        canvas.draw_text(&format!("policy {policy}: {group}{state}"), text, ink);
    }
}

/// Draws the groups of the stream so far as a strip, and the success of training below it.
fn draw_curves(canvas: &mut Canvas, run: &RunData, newest: usize) {
    let [left, top] = [GAP + LABELS, TOP + PERSPECTIVE_SIZE[1] + LEGEND_LINE + GAP];
    let width = canvas.width - left - GAP;
    let end = run.rollouts.last().map_or(1, |row| row.decisions.max(1));
    let x = |decisions: usize| left as f64 + width as f64 * decisions as f64 / end as f64;
    let (bottom, height) = (top + STRIP[0] + GAP + STRIP[1] - 2, STRIP[1] as f64 - 4.0);
    let y = |success: f64| bottom as f64 - height * success;
    for (level, name) in [(0.0, "0"), (1.0, "1")] {
        let at = y(level);
        canvas.blend_rectangle([left, at as usize], [width, 1], INK, 0.3);
        let line = (at as usize).saturating_sub(LINE_HEIGHT / 2);
        canvas.draw_text(name, [GAP, line], INK);
    }
    for visit in visits(&run.rollouts[..=newest]) {
        let own = colour(run, &run.rollouts[visit.start].group);
        let rows = &run.rollouts[visit.clone()];
        let from = visit.start.checked_sub(1).map_or(0, |before| run.rollouts[before].decisions);
        let last = rows.last().map_or(from, |row| row.decisions);
        canvas.fill_rectangle(
            [x(from) as usize, top],
            [(x(last) - x(from)).ceil() as usize, STRIP[0]],
            own,
        );
        let points: Vec<[f64; 2]> = (0..rows.len())
            .filter_map(|index| {
                let window = &rows[index.saturating_sub(WINDOW - 1)..=index];
                let known: Vec<f64> = window.iter().filter_map(|row| row.success).collect();
                (!known.is_empty()).then(|| [x(rows[index].decisions), y(mean(&known))])
            })
            .collect();
        for pair in points.windows(2) {
            canvas.draw_line(pair[0], pair[1], own);
        }
    }
}

fn colour(run: &RunData, group: &str) -> [u8; 3] {
    run.experiment.schedule.group_index(group).map_or(INK, curve_rgb)
}

#[cfg(test)]
mod tests {
    use super::*;
    use experiments::presets::{Budget, Method};

    fn run() -> RunData {
        let mut run = RunData::empty("run", Budget::Smoke.preset_experiment(Method::Covers));
        let names: Vec<String> =
            run.experiment.schedule.groups.iter().map(|plan| plan.group.clone()).collect();
        for (index, (group, policy)) in [(0, 0), (0, 0), (1, 1), (0, 0)].into_iter().enumerate() {
            run.rollouts.push(RolloutRow {
                decisions: 100 * (index + 1),
                group: names[group].clone(),
                policy,
                success: Some(index as f64 / 3.0),
                ..RolloutRow::default()
            });
        }
        run
    }

    #[test]
    fn visits_are_runs_of_one_group() {
        assert_eq!(visits(&run().rollouts), [0..2, 2..3, 3..4]);
        assert!(visits(&[]).is_empty());
    }

    #[test]
    fn the_policy_that_acts_is_lit_and_others_appear_once_they_exist() {
        let run = run();
        let clip = Clip {
            title: "goal-reach, flip x".to_owned(),
            caption: episode_caption(0, true),
            frames: vec![vec![7; PERSPECTIVE_SIZE[0] * PERSPECTIVE_SIZE[1] * 3]],
        };
        let count = |newest: usize, start: usize, colour: [u8; 3]| {
            let canvas = draw(&run, newest, start, &clip, 0);
            let pixels = canvas.rgb.chunks_exact(3);
            pixels.filter(|pixel| **pixel == colour).count()
        };
        let (first, second) = (curve_rgb(0), curve_rgb(1));
        let resting =
            first.map(|level| (255.0 * (1.0 - RESTING) + f32::from(level) * RESTING).round() as u8);
        let (lit, rest) = (count(0, 0, first), count(0, 0, resting));
        // edges of the title have lighter colours
        assert!(lit > 10_000 && rest < 200, "{lit} {rest}");
        assert_eq!(count(1, 0, second), 0, "the second policy does not exist yet");
        assert!(count(2, 2, second) > 10_000 && count(2, 2, resting) > 10_000);
        assert!(count(3, 3, first) > 10_000);
        let other = |title: &str, success| Clip {
            title: title.to_owned(),
            caption: episode_caption(0, success),
            frames: clip.frames.clone(),
        };
        let shown = |of: &Clip| draw(&run, 0, 0, of, 0).rgb;
        assert_ne!(shown(&clip), shown(&other(&clip.title, false)), "the outcome");
        assert_ne!(shown(&clip), shown(&other("goal-reach, flip y", true)), "the variant");
    }
}
