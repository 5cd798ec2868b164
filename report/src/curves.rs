//! Curves of runs, with the group that ran as the background.

use experiments::colours::{Stroke, stroke};

use super::method::MethodRuns;
use super::partners::partner;
use super::svg::{DOT, Drawing, INK, SMALL_DOT};
use experiments::evaluation::mean;
use experiments::{RolloutRow, RunData, ScoreRow};

/// The x axis.
const DECISIONS: &str = "decisions";
/// Ticks of shares.
const SHARES: [f64; 3] = [0.0, 0.5, 1.0];
/// Ticks of rewards, on the paper's scale.
const REWARDS: [f64; 3] = [0.0, 250.0, 500.0];
/// Larger ratios of distances are drawn here.
const MOST: f64 = 4.0;
/// Heights of panels (pixels).
const HIGH: f64 = 170.0;
const LOW: f64 = 90.0;

/// Success and reward of one run, rollouts as lines and evaluations as dots, the policy that was
/// assigned, and the distances by which.
pub fn run(run: &RunData) -> String {
    let mut drawing = Drawing::new(end(run), DECISIONS);
    let groups = run.groups();
    for (number, group) in groups.iter().enumerate() {
        drawing.legend(group, &stroke(number));
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
        drawing.line(&[(from, policy), (to, policy)], &Stroke::solid(INK));
    }
    distances(&mut drawing, run);
    drawing.finish(&format!("Success, reward and policy of {}", run.name))
}

/// What each policy's test said of each rollout: its distance, as a share of the largest one of the
/// permutations. Above 1 the rollout differs more than any of them; shares above [`MOST`] are drawn
/// there.
fn distances(drawing: &mut Drawing, run: &RunData) {
    if run.rollouts.iter().all(|row| row.distances.is_empty()) {
        return;
    }
    drawing.panel("distance, of chance", HIGH, [0.0, MOST], &[0.0, 1.0, 2.0, MOST]);
    visits(drawing, run);
    let colours = colours_of_policies(run);
    for row in &run.rollouts {
        let compared = row.distances.iter().zip(&row.null_maxima).enumerate();
        for (policy, (distance, most)) in compared {
            let Some(ratio) = distance.zip(*most).map(|(distance, most)| distance / most) else {
                continue;
            };
            let title = format!("policy {policy}: {ratio:.2} of the largest by chance");
            let point = (row.decisions as f64, ratio.min(MOST));
            let colour = colours.get(policy).copied().unwrap_or(INK);
            drawing.dot(point, SMALL_DOT, colour, &title);
        }
    }
    let end = end(run);
    drawing.line(&[(0.0, 1.0), (end, 1.0)], &Stroke::solid(INK));
}

/// Each policy has the colour of the group that it belongs to.
fn colours_of_policies(run: &RunData) -> Vec<&'static str> {
    let policies = run.rollouts.iter().map(|row| row.policy + 1).max();
    let mut colours = vec![INK; policies.unwrap_or(0)];
    for group in run.groups() {
        if let Some(policy) = partner(&run.rollouts, group) {
            colours[policy] = stroke_of(run, group).colour;
        }
    }
    colours
}

/// For each seed, a panel a method that ran with it: success in each group as dots, and their mean,
/// over groups that were met and groups to come, as a line. A method that forgets falls.
pub fn seeds(methods: &[MethodRuns]) -> Vec<(u64, String)> {
    let runs = || methods.iter().flat_map(|method| &method.runs);
    let mut seeds: Vec<u64> = runs().map(seed_of).collect();
    seeds.sort_unstable();
    seeds.dedup();
    let drawing = |seed| (seed, of_seed(methods, seed));
    seeds.into_iter().map(drawing).collect()
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
    let mut drawing = Drawing::new(longest, DECISIONS);
    let groups = runs.first().map_or_else(Vec::new, |(_, run)| run.groups());
    for (number, group) in groups.iter().enumerate() {
        drawing.legend(group, &stroke(number));
    }
    for (name, run) in runs {
        drawing.panel(name, LOW, [-0.05, 1.05], &SHARES);
        visits(&mut drawing, run);
        drawing.line(&averages(run), &Stroke::solid(INK));
        evaluations(&mut drawing, run, |row| row.success);
    }
    drawing.finish(&format!("Success of all methods, seed {seed}"))
}

/// Decisions and mean success over all variants of each evaluation.
fn averages(run: &RunData) -> Vec<(f64, f64)> {
    run.evaluated()
        .map(|rollouts| {
            let rows: Vec<&ScoreRow> = run.evaluation(Some(rollouts)).collect();
            let successes: Vec<f64> = rows.iter().map(|row| row.success).collect();
            (rows[0].decisions as f64, mean(&successes))
        })
        .collect()
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
        drawing.span(from, to, stroke_of(run, group).colour, group);
    }
}

fn rollouts(drawing: &mut Drawing, run: &RunData, figure: fn(&RolloutRow) -> Option<f64>) {
    for (group, _, rows) in visits_of(run) {
        let points = rows.iter().filter_map(|row| Some((row.decisions as f64, figure(row)?)));
        drawing.line(&points.collect::<Vec<_>>(), &stroke_of(run, group));
    }
}

fn evaluations(drawing: &mut Drawing, run: &RunData, figure: fn(&ScoreRow) -> f64) {
    for rollouts in run.evaluated() {
        for group in run.groups() {
            let Some((decisions, y)) = run.scored(rollouts, group, figure) else {
                continue;
            };
            let x = decisions as f64;
            let title = format!("{group}, {x} decisions: {y:.2}");
            drawing.dot((x, y), DOT, stroke_of(run, group).colour, &title);
        }
    }
}

/// One stroke for each group everywhere.
fn stroke_of(run: &RunData, group: &str) -> Stroke {
    let number = run.groups().iter().position(|own| *own == group);
    number.map_or(Stroke::solid(INK), stroke)
}
