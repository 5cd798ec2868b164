//! Panel of the distances of the latest rollout to the stored rollouts of each policy.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::Style;
use ratatui::text::Span;
use ratatui::widgets::{Block, Cell, Row, Table};

use experiments::RunData;
use experiments::text::format_number;

use super::panels::{draw_distance_ratios, policy_colour};

/// Largest length of a bar that shows a distance (terminal cells).
const BAR: u16 = 20;
/// Widths of the columns before the bar: policy, distance and threshold (terminal cells).
const COLUMNS: [u16; 3] = [9, 5, 5];

/// Minimum height (terminal rows) of the panel of distances to show earlier rollouts, too.
const WITH_RATIOS: u16 = 14;

/// Draws a row for each policy that the latest rollout was compared with: the distance, the
/// threshold, and a bar of their ratio. If there is room, the ratios of all rollouts follow below.
/// A rule that decides by more than the distance has no threshold: the distances stand alone.
pub fn draw_policy_distances(run: &RunData, frame: &mut Frame, area: Rect) {
    let newest = run.rollouts.last();
    let distances = newest.map_or(&[][..], |row| &row.distances[..]);
    let thresholds = newest.map_or_else(Vec::new, |row| run.policy_distance_thresholds(row));
    let with_thresholds = thresholds.iter().any(Option::is_some);
    let columns = if with_thresholds { 4 } else { 2 };
    let title = match (run.rollouts.len(), distances) {
        (0, _) => "W1: no rollout yet".to_owned(),
        (rollouts, []) => format!("W1: none in rollout {}", rollouts - 1),
        (rollouts, _) => format!("W1 of rollout {}", rollouts - 1),
    };
    let thresholds = thresholds.into_iter().chain(std::iter::repeat(None));
    let room = area.width.saturating_sub(COLUMNS.iter().map(|width| width + 1).sum::<u16>() + 2);
    let length = room.min(BAR);
    let compared = distances.iter().zip(thresholds).enumerate();
    let rows = compared.map(|(policy, (&distance, threshold))| {
        let colour = Style::new().fg(policy_colour(run, policy));
        let ratio = distance.zip(threshold).map(|(distance, threshold)| distance / threshold);
        Row::new(
            [
                Cell::new(Span::styled(format!("policy {policy}"), colour)),
                Cell::new(format_number(distance, 2)),
                Cell::new(format_number(threshold, 2)),
                Cell::new(Span::styled(bar(ratio, length.into()), colour)),
            ]
            .into_iter()
            .take(columns),
        )
    });
    let widths = COLUMNS.into_iter().chain([length]).take(columns).map(Constraint::Length);
    let header = ["", "W1", "limit", ""].into_iter().take(columns);
    let header = Row::new(header).style(Style::new().bold());
    let table = Table::new(rows, widths).header(header);
    let block = Block::bordered().title(title);
    let inner = block.inner(area);
    frame.render_widget(block, area);
    let height = if with_thresholds && inner.height >= WITH_RATIOS {
        // a row for the header; the bound of 99 keeps the number within u16
        (inner.height / 2).min(distances.len().min(99) as u16 + 1)
    } else {
        inner.height
    };
    let heights = [Constraint::Length(height), Constraint::Fill(1)];
    let [top, all] = Layout::vertical(heights).areas(inner);
    frame.render_widget(table, top);
    if !all.is_empty() {
        draw_distance_ratios(run, frame, all);
    }
}

/// Formats a distance over its threshold as a bar of `length` cells that is full at twice the
/// threshold, with a mark at its middle; a dash if the ratio is not a number of 0 or more.
fn bar(ratio: Option<f64>, length: usize) -> String {
    let Some(ratio) = ratio.filter(|ratio| ratio.is_finite() && *ratio >= 0.0) else {
        return "-".to_owned();
    };
    let middle = length / 2;
    let full = ((ratio * middle as f64).round() as usize).min(length);
    let cell = |at: usize| match (at == middle, at < full) {
        (true, _) => '│',
        (false, true) => '█',
        (false, false) => ' ',
    };
    (0..length).map(cell).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_threshold_stands_in_the_middle_of_a_bar() {
        let filled = |ratio| bar(Some(ratio), 20).matches('█').count();
        assert_eq!(bar(Some(0.5), 20), "█████     │         ");
        assert_eq!((filled(0.0), filled(1.0), filled(9.0)), (0, 10, 19));
        for none in [None, Some(f64::NAN), Some(f64::INFINITY), Some(-1.0)] {
            assert_eq!(bar(none, 20), "-");
        }
    }
}
