//! Curves of a run: a colour a group, a line a visit, a dot an evaluation.

use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::{Color, Style};
use ratatui::symbols::Marker;
use ratatui::widgets::{Axis, Block, Chart, Dataset, GraphType};

use experiments::{RolloutRow, RunData, ScoreRow};

use super::{Pace, ink};

/// What a curve shows.
pub struct Figure {
    title: &'static str,
    /// The largest value.
    most: f64,
    rollout: fn(&RolloutRow) -> Option<f64>,
    score: fn(&ScoreRow) -> f64,
}

pub const REWARD: Figure = Figure {
    title: "reward of 500",
    most: 500.0,
    rollout: |row| row.reward,
    score: |row| row.reward,
};
pub const SUCCESS: Figure =
    Figure { title: "success", most: 1.0, rollout: |row| row.success, score: |row| row.success };

/// Points of one colour.
struct Line {
    colour: Color,
    points: Vec<(f64, f64)>,
    kind: GraphType,
}

/// Draws the figure over the decisions of the whole stream.
pub fn draw(figure: &Figure, run: &RunData, frame: &mut Frame, area: Rect) {
    let stream = Pace::after(run, 0).stream as f64;
    let newest = run.rollouts.last().map_or(0.0, |row| row.decisions as f64);
    let end = stream.max(newest);
    let lines: Vec<Line> =
        visits(figure, run).into_iter().chain(evaluations(figure, run)).collect();
    let sets = lines.iter().map(|line| {
        let marker = match line.kind {
            GraphType::Scatter => Marker::Dot,
            _ => Marker::Braille,
        };
        Dataset::default()
            .marker(marker)
            .graph_type(line.kind)
            .style(Style::new().fg(line.colour))
            .data(&line.points)
    });
    let middle = figure.most / 2.0;
    let labels = |values: [f64; 3]| values.map(|value| value.to_string());
    let chart = Chart::new(sets.collect())
        .block(Block::bordered().title(figure.title))
        .x_axis(
            Axis::default().bounds([0.0, end]).labels(["0".to_owned(), format!("{end} decisions")]),
        )
        .y_axis(Axis::default().bounds([0.0, figure.most]).labels(labels([
            0.0,
            middle,
            figure.most,
        ])));
    frame.render_widget(chart, area);
}

/// The rollouts of each visit of a group.
fn visits(figure: &Figure, run: &RunData) -> Vec<Line> {
    let same = |one: &RolloutRow, other: &RolloutRow| one.group == other.group;
    let visits = run.rollouts.chunk_by(same);
    let line = |rows: &[RolloutRow]| {
        let points = rows.iter().filter_map(|row| {
            let value = (figure.rollout)(row).filter(|value| value.is_finite())?;
            Some((row.decisions as f64, value))
        });
        Line {
            colour: ink::of_group(run, &rows[0].group),
            points: points.collect(),
            kind: GraphType::Line,
        }
    };
    visits.map(line).collect()
}

/// The means of each group's variants, at each evaluation.
fn evaluations(figure: &Figure, run: &RunData) -> Vec<Line> {
    let plans = run.experiment.schedule.groups.iter();
    let line = |group: &str| {
        let points = run.evaluated().filter_map(|rollouts| {
            let (decisions, value) = run.scored(rollouts, group, figure.score)?;
            Some((decisions as f64, value)).filter(|(_, value)| value.is_finite())
        });
        Line {
            colour: ink::of_group(run, group),
            points: points.collect(),
            kind: GraphType::Scatter,
        }
    };
    plans.map(|plan| line(&plan.group)).collect()
}
