//! How far each rollout was from what each policy remembers, over the whole stream.

use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::{Color, Style};
use ratatui::symbols::Marker;
use ratatui::widgets::{Axis, Block, Borders, Chart, Dataset, GraphType};

use experiments::RunData;

use super::{Pace, ink};

/// Larger ratios are drawn here.
const MOST: f64 = 4.0;

/// Draws a dot for each distance, as a share of its threshold, in the policy's colour. Where the
/// threshold is that of chance, a rollout above the line is hardly of the policy's group.
pub fn draw(run: &RunData, frame: &mut Frame, area: Rect) {
    let newest = run.rollouts.last().map_or(0.0, |row| row.decisions as f64);
    let end = newest.max(Pace::after(run, 0).stream as f64);
    let policies = run.rollouts.iter().map(|row| row.distances.len()).max();
    let dots: Vec<Vec<(f64, f64)>> =
        (0..policies.unwrap_or(0)).map(|policy| dots(run, policy)).collect();
    let one = [(0.0, 1.0), (end, 1.0)];
    let line = Dataset::default()
        .marker(Marker::Braille)
        .graph_type(GraphType::Line)
        .style(Style::new().fg(Color::DarkGray))
        .data(&one);
    let sets = dots.iter().enumerate().map(|(policy, dots)| {
        Dataset::default()
            .marker(Marker::Braille)
            .style(Style::new().fg(ink::of_policy(run, policy)))
            .data(dots)
    });
    let chart = Chart::new(std::iter::once(line).chain(sets).collect())
        .block(Block::new().borders(Borders::TOP).title("W1 / threshold"))
        .x_axis(Axis::default().bounds([0.0, end]))
        .y_axis(Axis::default().bounds([0.0, MOST]).labels(["0", "2", "4"]));
    frame.render_widget(chart, area);
}

/// Decisions and ratios of one policy's distances.
fn dots(run: &RunData, policy: usize) -> Vec<(f64, f64)> {
    let rows = run.rollouts.iter().filter_map(|row| {
        let threshold = run.thresholds(row).get(policy).copied()??;
        let ratio = row.distances.get(policy).copied()?? / threshold;
        Some((row.decisions as f64, ratio.min(MOST))).filter(|_| ratio.is_finite())
    });
    rows.collect()
}
