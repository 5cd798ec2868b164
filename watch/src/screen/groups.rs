//! The newest figures of each group.

use ratatui::Frame;
use ratatui::layout::{Constraint, Rect};
use ratatui::style::Style;
use ratatui::text::Span;
use ratatui::widgets::{Block, Cell, Row, Table};

use experiments::RunData;
use experiments::evaluation::mean;
use experiments::text::number;

use super::ink;

/// Draws a row for each group: the newest rollout's policy, reward and success, and the success of
/// the last evaluation, over all variants.
pub fn draw(run: &RunData, frame: &mut Frame, area: Rect) {
    let plans = run.experiment.schedule.groups.iter();
    let rows = plans.map(|plan| row(run, &plan.group));
    let widths = [14, 8, 6, 6, 7, 9].map(Constraint::Length);
    let header = ["group", "rollouts", "policy", "reward", "success", "evaluated"];
    let table = Table::new(rows, widths)
        .header(Row::new(header).style(Style::new().bold()))
        .block(Block::bordered().title("groups, newest figures"));
    frame.render_widget(table, area);
}

fn row<'a>(run: &RunData, group: &'a str) -> Row<'a> {
    let own = || run.rollouts.iter().filter(|row| row.group == group);
    let newest = own().next_back();
    let policy = newest.map_or_else(|| "-".to_owned(), |row| row.policy.to_string());
    let scores = run.last_scores().filter(|row| row.group == group);
    let scores: Vec<f64> = scores.map(|row| row.success).collect();
    let evaluated = (!scores.is_empty()).then(|| mean(&scores));
    let name = Span::styled(format!("■ {group}"), ink::of_group(run, group));
    Row::new([
        Cell::new(name),
        Cell::new(own().count().to_string()),
        Cell::new(policy),
        Cell::new(number(newest.and_then(|row| row.reward), 1)),
        Cell::new(number(newest.and_then(|row| row.success), 2)),
        Cell::new(number(evaluated, 2)),
    ])
}
