//! Curves of reward and success of a run: a colour for each group, a line for each visit, a dot for
//! each evaluation.

use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::{Color, Style};
use ratatui::symbols::Marker;
use ratatui::widgets::{Axis, Block, Chart, Dataset, GraphType};

use experiments::{RolloutRow, RunData, ScoreRow};

use super::StreamProgress;
use super::panels::group_colour;

/// Quantity of a run, such as its reward, that a curve on the screen shows.
pub struct CurveQuantity {
    title: &'static str,
    /// Upper end of the vertical axis, which begins at 0.
    largest: f64,
    rollout: fn(&RolloutRow) -> Option<f64>,
    score: fn(&ScoreRow) -> f64,
}

/// Mean return of a rollout's episodes on the paper's scale, at most 500.
pub const REWARD_CURVE: CurveQuantity = CurveQuantity {
    title: "reward of 500",
    largest: 500.0,
    rollout: |row| row.reward,
    score: |row| row.reward,
};
/// Share of a rollout's episodes that succeeded.
pub const SUCCESS_CURVE: CurveQuantity = CurveQuantity {
    title: "success",
    largest: 1.0,
    rollout: |row| row.success,
    score: |row| row.success,
};

/// Points of one colour in a chart: a line or dots.
struct Line {
    colour: Color,
    points: Vec<(f64, f64)>,
    kind: GraphType,
}

/// Draws a quantity over the decisions of the whole stream: a line for each visit to a group, and a
/// dot for each evaluation of a group.
pub fn draw_curve(figure: &CurveQuantity, run: &RunData, frame: &mut Frame, area: Rect) {
    let stream = StreamProgress::after_rollouts(run, 0).total_decisions as f64;
    let newest = run.rollouts.last().map_or(0.0, |row| row.decisions as f64);
    // a stream whose clock counts turns may take more decisions than planned
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
    let labels = [0.0, figure.largest / 2.0, figure.largest].map(|value| value.to_string());
    let chart = Chart::new(sets.collect())
        .block(Block::bordered().title(figure.title))
        .x_axis(
            Axis::default().bounds([0.0, end]).labels(["0".to_owned(), format!("{end} decisions")]),
        )
        .y_axis(Axis::default().bounds([0.0, figure.largest]).labels(labels));
    frame.render_widget(chart, area);
}

/// Returns a line for each visit of the stream to a group: the visit's rollouts, in order.
fn visits(figure: &CurveQuantity, run: &RunData) -> Vec<Line> {
    let same = |one: &RolloutRow, other: &RolloutRow| one.group == other.group;
    let visits = run.rollouts.chunk_by(same);
    let line = |rows: &[RolloutRow]| {
        let points = rows.iter().filter_map(|row| {
            let value = (figure.rollout)(row).filter(|value| value.is_finite())?;
            Some((row.decisions as f64, value))
        });
        Line {
            colour: group_colour(run, &rows[0].group),
            points: points.collect(),
            kind: GraphType::Line,
        }
    };
    visits.map(line).collect()
}

/// Returns dots for each group: the mean of its variants at each evaluation.
fn evaluations(figure: &CurveQuantity, run: &RunData) -> Vec<Line> {
    let plans = run.experiment.schedule.groups.iter();
    let line = |group: &str| {
        let points = run.rollouts_before_evaluations().filter_map(|rollouts| {
            let (decisions, value) = run.mean_group_score_after(rollouts, group, figure.score)?;
            Some((decisions as f64, value)).filter(|(_, value)| value.is_finite())
        });
        Line {
            colour: group_colour(run, group),
            points: points.collect(),
            kind: GraphType::Scatter,
        }
    };
    plans.map(|plan| line(&plan.group)).collect()
}
