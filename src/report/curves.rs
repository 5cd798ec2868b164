//! Curves of runs, with the group that ran as the background.

use super::method::MethodRuns;
use super::run_data::{RolloutRow, RunData, ScoreRow};
use super::statistics::mean;
use super::svg::{COLOURS, Drawing};

/// Ticks of shares.
const SHARES: [f64; 3] = [0.0, 0.5, 1.0];
/// Ticks of rewards, on the paper's scale.
const REWARDS: [f64; 3] = [0.0, 250.0, 500.0];
/// Heights of panels (pixels).
const HIGH: f64 = 170.0;
const LOW: f64 = 70.0;

/// Success and reward of one run, rollouts as lines and evaluations as dots, and the policy that
/// was assigned.
pub fn run(run: &RunData) -> String {
    let mut drawing = Drawing::new(end(run));
    let groups = run.groups();
    for (group, colour) in groups.iter().zip(COLOURS) {
        drawing.legend(group, colour);
    }
    drawing.panel("success", HIGH, [-0.03, 1.03], &SHARES);
    visits(&mut drawing, run);
    rollouts(&mut drawing, run, |row| row.success);
    evaluations(&mut drawing, run, |row| row.success);
    drawing.panel("reward of 500", HIGH, [0.0, 500.0], &REWARDS);
    visits(&mut drawing, run);
    rollouts(&mut drawing, run, |row| row.reward);
    evaluations(&mut drawing, run, |row| row.reward);
    let most = run.rollouts.iter().map(|row| row.policy).max().unwrap_or(0);
    let numbers: Vec<f64> = (0..=most).map(|policy| policy as f64).collect();
    drawing.panel("policy", LOW, [-0.5, most as f64 + 0.5], &numbers);
    visits(&mut drawing, run);
    for (row, [from, to]) in run.rollouts.iter().zip(spans(run)) {
        let policy = row.policy as f64;
        drawing.line(&[(from, policy), (to, policy)], "black");
    }
    drawing.finish(&format!("Success, reward and policy of {}", run.name))
}

/// For each seed, the success over all groups of every method that ran with it: the groups met so
/// far and those to come, so that a method that forgets falls.
pub fn seeds(methods: &[MethodRuns]) -> Vec<(u64, String)> {
    let of = |method: &MethodRuns| -> Vec<u64> {
        method
            .runs
            .iter()
            .map(|run| run.experiment.learner.seed())
            .collect()
    };
    let mut seeds: Vec<u64> = methods.iter().flat_map(of).collect();
    seeds.sort_unstable();
    seeds.dedup();
    seeds
        .into_iter()
        .map(|seed| (seed, methods_of(methods, seed)))
        .collect()
}

fn methods_of(methods: &[MethodRuns], seed: u64) -> String {
    let of = |method: &'_ MethodRuns| -> Option<RunData> {
        let mut runs = method.runs.iter();
        runs.find(|run| run.experiment.learner.seed() == seed)
            .cloned()
    };
    let runs: Vec<(&str, RunData)> = methods
        .iter()
        .filter_map(|method| of(method).map(|run| (method.name.as_str(), run)))
        .collect();
    let longest = runs.iter().map(|(_, run)| end(run)).fold(0.0, f64::max);
    let mut drawing = Drawing::new(longest);
    drawing.panel(
        "success over all groups",
        2.0 * HIGH,
        [-0.03, 1.03],
        &SHARES,
    );
    if let Some((_, run)) = runs.first() {
        visits(&mut drawing, run);
    }
    for ((name, run), colour) in runs.iter().zip(COLOURS.into_iter().cycle()) {
        drawing.legend(name, colour);
        let points = averages(run);
        drawing.line(&points, colour);
        for (x, y) in points {
            drawing.dot((x, y), colour, &format!("{name}, {x} decisions: {y:.3}"));
        }
    }
    drawing.finish(&format!(
        "Success of all methods over all groups, seed {seed}"
    ))
}

/// Decisions and mean success over all variants of each evaluation.
fn averages(run: &RunData) -> Vec<(f64, f64)> {
    evaluated(run)
        .map(|rollouts| {
            let rows: Vec<&ScoreRow> = run.evaluation(Some(rollouts)).collect();
            let successes: Vec<f64> = rows.iter().map(|row| row.success).collect();
            (rows[0].decisions as f64, mean(&successes))
        })
        .collect()
}

/// After how many rollouts evaluations came.
fn evaluated(run: &RunData) -> impl Iterator<Item = usize> {
    let mut moments: Vec<usize> = run.scores.iter().map(|row| row.rollouts).collect();
    moments.dedup();
    moments.into_iter()
}

fn end(run: &RunData) -> f64 {
    run.rollouts.last().map_or(0.0, |row| row.decisions as f64)
}

/// Decisions from and to, of each rollout.
fn spans(run: &RunData) -> impl Iterator<Item = [f64; 2]> {
    let ends = run.rollouts.iter().map(|row| row.decisions as f64);
    let begins = std::iter::once(0.0).chain(ends.clone());
    begins.zip(ends).map(|(from, to)| [from, to])
}

/// Rollouts that follow one another in one group, with their decisions from and to.
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

fn visits(drawing: &mut Drawing, run: &RunData) {
    for (group, [from, to], _) in visits_of(run) {
        drawing.span(from, to, colour(run, group), group);
    }
}

fn rollouts(drawing: &mut Drawing, run: &RunData, figure: fn(&RolloutRow) -> Option<f64>) {
    for (group, _, rows) in visits_of(run) {
        let points = rows
            .iter()
            .filter_map(|row| Some((row.decisions as f64, figure(row)?)));
        drawing.line(&points.collect::<Vec<_>>(), colour(run, group));
    }
}

fn evaluations(drawing: &mut Drawing, run: &RunData, figure: fn(&ScoreRow) -> f64) {
    for rollouts in evaluated(run) {
        for group in run.groups() {
            let rows = run
                .evaluation(Some(rollouts))
                .filter(|row| row.group == group);
            let rows: Vec<&ScoreRow> = rows.collect();
            let Some(first) = rows.first() else { continue };
            let figures: Vec<f64> = rows.iter().map(|row| figure(row)).collect();
            let (x, y) = (first.decisions as f64, mean(&figures));
            let title = format!("{group}, {x} decisions: {y:.2}");
            drawing.dot((x, y), colour(run, group), &title);
        }
    }
}

/// One colour a group everywhere.
fn colour(run: &RunData, group: &str) -> &'static str {
    let index = run.groups().iter().position(|own| *own == group);
    COLOURS[index.unwrap_or(COLOURS.len() - 1) % COLOURS.len()]
}
