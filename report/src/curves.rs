//! Curves of runs over the stream, with the current group as background colour.

use experiments::colours::{LineStyle, curve_style};

use super::matching::own_policy_of_group;
use super::method::MethodRuns;
use super::svg::{DOT_RADIUS, SMALL_DOT_RADIUS, SvgPlot, TEXT_COLOUR};
use super::visits::groups_of_run;
use experiments::evaluation::mean;
use experiments::{RolloutRow, RunData, ScoreRow};

const SUCCESS_TICKS: [f64; 3] = [0.0, 0.5, 1.0];
/// Ticks of the reward axis, on the paper's scale of `[0, 500]`.
const REWARD_TICKS: [f64; 3] = [0.0, 250.0, 500.0];
/// Lowest and highest drawn distance of a rollout to a policy, in standard deviations; others are
/// drawn at these values.
const Z_SCORES: [f64; 2] = [-3.0, 20.0];
const Z_SCORE_TICKS: [f64; 4] = [0.0, 5.0, 10.0, 20.0];
/// Height of a panel with a curve to read values from (pixels).
const TALL_PANEL: f64 = 170.0;
/// Height of a panel that shows the course alone (pixels).
const LOW_PANEL: f64 = 90.0;

/// Returns the label of an x axis that counts training decisions of a run: `what`, and the number
/// of control steps that each decision lasts.
pub fn decisions_axis_label(what: &str, run: &RunData) -> String {
    format!("{what} ({} control steps each)", run.experiment.envs.control.action_repeat)
}

/// Draws one run as SVG: success and reward, rollouts as lines and evaluations as dots, the
/// assigned policies, and the distances that the assignment rests on.
pub fn run_curves_svg(run: &RunData) -> String {
    let mut drawing = SvgPlot::new(end(run), &decisions_axis_label("decisions", run));
    let groups = groups_of_run(run);
    for (number, group) in groups.iter().enumerate() {
        drawing.add_legend_entry(group, &curve_style(number));
    }
    // 3 % of room on either side keeps dots at 0 and 1 inside the frame
    drawing.begin_panel("success", TALL_PANEL, [-0.03, 1.03], &SUCCESS_TICKS);
    visits(&mut drawing, run);
    rollouts(&mut drawing, run, |row| row.success);
    evaluations(&mut drawing, run, |row| row.success);
    drawing.begin_panel("reward of 500", TALL_PANEL, [0.0, 500.0], &REWARD_TICKS);
    visits(&mut drawing, run);
    rollouts(&mut drawing, run, |row| row.reward);
    evaluations(&mut drawing, run, |row| row.reward);
    let most = run.policy_count().saturating_sub(1);
    let numbers: Vec<f64> = (0..=most).map(|policy| policy as f64).collect();
    drawing.begin_panel("policy", LOW_PANEL, [-0.5, most as f64 + 0.5], &numbers);
    visits(&mut drawing, run);
    for (row, [from, to]) in run.rollouts.iter().zip(spans(run)) {
        let policy = row.policy as f64;
        drawing.add_line(&[(from, policy), (to, policy)], &LineStyle::solid(TEXT_COLOUR));
    }
    distances(&mut drawing, run);
    drawing.into_svg(&format!("Success, reward and policy of {}", run.name))
}

/// Draws how far each rollout is from each policy, in standard deviations of the distances between
/// random splits: about 0 for a policy of the same group.
fn distances(drawing: &mut SvgPlot, run: &RunData) {
    let mut scores = run.rollouts.iter().flat_map(|row| &row.permutation_z_scores);
    if scores.all(Option::is_none) {
        return;
    }
    drawing.begin_panel("distance (sd)", TALL_PANEL, Z_SCORES, &Z_SCORE_TICKS);
    visits(drawing, run);
    let colours = colours_of_policies(run);
    for row in &run.rollouts {
        for (policy, score) in row.permutation_z_scores.iter().enumerate() {
            let Some(score) = score else { continue };
            let title =
                format!("policy {policy}: {score:.1} standard deviations above random splits");
            let point = (row.decisions as f64, score.clamp(Z_SCORES[0], Z_SCORES[1]));
            let colour = colours.get(policy).copied().unwrap_or(TEXT_COLOUR);
            drawing.add_dot(point, SMALL_DOT_RADIUS, colour, &title);
        }
    }
}

/// Returns the colour of each policy: that of the task group that it belongs to, if there is one.
fn colours_of_policies(run: &RunData) -> Vec<&'static str> {
    let mut colours = vec![TEXT_COLOUR; run.policy_count()];
    for group in groups_of_run(run) {
        if let Some(policy) = own_policy_of_group(&run.rollouts, group) {
            colours[policy] = stroke_of(run, group).colour;
        }
    }
    colours
}

/// Draws one SVG for each seed with more than one evaluation, with a panel for each method that ran
/// with it: success in each group as dots, and the mean over all groups, visited or not yet
/// visited, as a line. The line of a method that forgets falls.
pub fn success_svg_per_seed(methods: &[MethodRuns]) -> Vec<(u64, String)> {
    let runs = methods.iter().flat_map(|method| &method.runs);
    let is_curve = |run: &&RunData| run.rollouts_before_evaluations().count() > 1;
    let mut seeds: Vec<u64> = runs.filter(is_curve).map(seed_of).collect();
    seeds.sort_unstable();
    seeds.dedup();
    seeds.into_iter().map(|seed| (seed, of_seed(methods, seed))).collect()
}

fn seed_of(run: &RunData) -> u64 {
    run.experiment.learner.seed()
}

fn of_seed(methods: &[MethodRuns], seed: u64) -> String {
    let run_of = |method: &'_ MethodRuns| method.runs.iter().position(|run| seed_of(run) == seed);
    let runs: Vec<(&str, &RunData)> = methods
        .iter()
        .filter_map(|method| Some((method.name.as_str(), &method.runs[run_of(method)?])))
        .collect();
    let longest = runs.iter().map(|(_, run)| end(run)).fold(0.0, f64::max);
    let axis =
        runs.first().map_or_else(String::new, |(_, run)| decisions_axis_label("decisions", run));
    let mut drawing = SvgPlot::new(longest, &axis);
    let groups = runs.first().map_or_else(Vec::new, |(_, run)| groups_of_run(run));
    for (number, group) in groups.iter().enumerate() {
        drawing.add_legend_entry(group, &curve_style(number));
    }
    for (name, run) in runs {
        // more room than above, since this panel is lower and its dots are as large
        drawing.begin_panel(name, LOW_PANEL, [-0.05, 1.05], &SUCCESS_TICKS);
        visits(&mut drawing, run);
        drawing.add_line(&stream_success_curve(run), &LineStyle::solid(TEXT_COLOUR));
        evaluations(&mut drawing, run, |row| row.success);
    }
    drawing.into_svg(&format!("Success of all methods, seed {seed}"))
}

/// Returns a point (training decisions, mean success over all task variants) for each evaluation of
/// a run.
pub fn stream_success_curve(run: &RunData) -> Vec<(f64, f64)> {
    run.rollouts_before_evaluations()
        .map(|rollouts| {
            let rows: Vec<&ScoreRow> = run.scores_after(Some(rollouts)).collect();
            let successes: Vec<f64> = rows.iter().map(|row| row.success).collect();
            (rows[0].decisions as f64, mean(&successes))
        })
        .collect()
}

fn end(run: &RunData) -> f64 {
    run.rollouts.last().map_or(0.0, |row| row.decisions as f64)
}

/// Returns the numbers of training decisions at the beginning and at the end of each rollout.
fn spans(run: &RunData) -> impl Iterator<Item = [f64; 2]> {
    let ends = run.rollouts.iter().map(|row| row.decisions as f64);
    let begins = std::iter::once(0.0).chain(ends.clone());
    begins.zip(ends).map(|(from, to)| [from, to])
}

/// Returns the visits of a run to task groups, each as its group, the decisions at its beginning
/// and end, and its rollouts.
fn visits_of(run: &RunData) -> Vec<(&str, [f64; 2], Vec<&RolloutRow>)> {
    let mut visits: Vec<(&str, [f64; 2], Vec<&RolloutRow>)> = Vec::new();
    for (row, [from, to]) in run.rollouts.iter().zip(spans(run)) {
        match visits.last_mut() {
            Some((group, span, rows)) if *group == row.group => {
                span[1] = to;
                rows.push(row);
            }
            _ => visits.push((&row.group, [from, to], vec![row])),
        }
    }
    visits
}

fn visits(drawing: &mut SvgPlot, run: &RunData) {
    for (group, [from, to], _) in visits_of(run) {
        drawing.shade_span(from, to, stroke_of(run, group).colour, group);
    }
}

fn rollouts(drawing: &mut SvgPlot, run: &RunData, value: fn(&RolloutRow) -> Option<f64>) {
    for (group, _, rows) in visits_of(run) {
        let points = rows.iter().filter_map(|row| Some((row.decisions as f64, value(row)?)));
        let (points, stroke) = (points.collect::<Vec<_>>(), stroke_of(run, group));
        match points[..] {
            // a line of one point is invisible
            [point] => drawing.add_dot(point, SMALL_DOT_RADIUS, stroke.colour, group),
            _ => drawing.add_line(&points, &stroke),
        }
    }
}

fn evaluations(drawing: &mut SvgPlot, run: &RunData, value: fn(&ScoreRow) -> f64) {
    for rollouts in run.rollouts_before_evaluations() {
        for group in groups_of_run(run) {
            let Some((decisions, y)) = run.mean_group_score_after(rollouts, group, value) else {
                continue;
            };
            let x = decisions as f64;
            let title = format!("{group}, {x} decisions: {y:.2}");
            drawing.add_dot((x, y), DOT_RADIUS, stroke_of(run, group).colour, &title);
        }
    }
}

/// Returns the line style of a task group, which is equal in all drawings of a run.
fn stroke_of(run: &RunData, group: &str) -> LineStyle {
    let number = groups_of_run(run).iter().position(|own| *own == group);
    number.map_or(LineStyle::solid(TEXT_COLOUR), curve_style)
}
