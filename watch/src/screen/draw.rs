//! Layout of the screen that shows a run: more panels on larger terminals.

use std::time::Duration;

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Clear, Paragraph};

use experiments::RunData;
use experiments::sheet::Picture;
use experiments::text::format_number;

use super::panels::{
    draw_assignment_strips, draw_groups_table, draw_picture, fitted_picture_area, group_colour,
    groups_table_width, policy_colour,
};
use super::{StreamProgress, curves, distances};

/// Minimum columns and rows of a terminal for every panel.
const LARGE: [u16; 2] = [100, 30];
/// Minimum terminal rows between headline and footline for a screen with tables.
const MEDIUM: u16 = 20;
/// Minimum terminal columns for two curves side by side.
const TWO_CURVES: u16 = 70;
/// Minimum columns of the table of distances beside that of groups.
const DISTANCES: u16 = 24;
/// Explanation of the screen.
const HELP: [&str; 7] = [
    "lines: rollouts of training, dots: evaluations",
    "group: letter of the group that ran",
    "policy: number of the policy that the rollout went to",
    "two colours in a column: the policy of another group",
    "scored: success in the latest evaluation",
    "W1 / threshold: above 1 a rollout is unlike a policy's",
    "q quits, ? closes this help",
];
/// Height of the tables of groups and distances (terminal rows).
const TABLES: u16 = 8;
/// Height of the two strips of rollouts, by group and by policy, with their frame (terminal rows).
const STRIPS: u16 = 4;

/// Contents of the terminal screen that shows a run.
pub struct ScreenContents<'a> {
    pub run: &'a RunData,
    pub finished: bool,
    /// Time since the latest change of the run's tables.
    pub time_since_change: Option<Duration>,
    /// Camera picture to show, with its title.
    pub picture: Option<(String, Picture)>,
    /// Help for the keys, or a message, in the footline.
    pub key_help: &'a str,
    /// `true` to explain the screen over its body.
    pub explained: bool,
}

/// Draws the screen of a run on a terminal frame.
pub fn draw_run_screen(shown: &ScreenContents<'_>, frame: &mut Frame) {
    let area = frame.area();
    let rows = [Constraint::Length(2), Constraint::Fill(1), Constraint::Length(1)];
    let [head, body, foot] = Layout::vertical(rows).areas(area);
    frame.render_widget(Paragraph::new(headline(shown).to_vec()), head);
    let [width, height] = LARGE;
    if area.width >= width && area.height >= height {
        large(shown, frame, body);
    } else if body.height >= MEDIUM {
        medium(shown, frame, body);
    } else {
        small(shown, frame, body);
    }
    if shown.explained {
        let widest = HELP.iter().map(|line| line.len()).max().unwrap_or(0) as u16 + 2;
        let help = body.centered(widest.into(), (HELP.len() as u16 + 2).into());
        frame.render_widget(Clear, help);
        let text: Vec<Line> = HELP.map(Line::from).to_vec();
        frame.render_widget(Paragraph::new(text).block(Block::bordered().title("help")), help);
    }
    frame.render_widget(Line::from(footline(shown)).style(Style::new().dim()), foot);
}

/// Returns two lines: the run's name and current group, and its progress.
fn headline<'a>(shown: &ScreenContents<'a>) -> [Line<'a>; 2] {
    let run = shown.run;
    let name = Span::styled(&run.name, Style::new().bold());
    let progress = StreamProgress::after_rollouts(run, run.rollouts.len());
    let now = match (shown.finished, run.rollouts.last()) {
        (true, _) => vec![Span::raw("finished")],
        (false, Some(_)) if progress.completed_decisions >= progress.total_decisions => {
            vec![Span::raw("last evaluation")]
        }
        (false, None) => vec![Span::raw("begins")],
        (false, Some(row)) => vec![
            Span::styled(row.last_group.clone(), group_colour(run, &row.last_group)),
            Span::raw(", policy "),
            Span::styled(row.policy.to_string(), policy_colour(run, row.policy)),
        ],
    };
    let first = [name, Span::raw("  ")].into_iter().chain(now).collect();
    [first, Line::from(progress_text(shown))]
}

fn progress_text(shown: &ScreenContents<'_>) -> String {
    let progress = StreamProgress::after_rollouts(shown.run, shown.run.rollouts.len());
    let StreamProgress { total_decisions, completed_decisions, .. } = progress;
    let share = completed_decisions.saturating_mul(100) / total_decisions.max(1);
    let left = if shown.finished { Some(0.0) } else { progress.seconds_left };
    let left = left.map_or_else(|| "-".to_owned(), duration);
    let rate = format_number(progress.decisions_per_second, 0);
    format!(
        "{share} %, {left} left, {rate} decisions/s, {completed_decisions} of {total_decisions} \
         decisions"
    )
}

fn footline(shown: &ScreenContents<'_>) -> String {
    let silence = shown.time_since_change.filter(|_| !shown.finished);
    let silence = silence.map(|silence| silence.as_secs_f64()).map(duration);
    let newest = silence.map_or_else(String::new, |age| format!("  newest row {age} old"));
    format!("{}  ? explains{newest}", shown.key_help)
}

/// Formats a duration (seconds) in hours and minutes, minutes or seconds.
fn duration(seconds: f64) -> String {
    let whole = seconds as u64;
    match (whole / 3600, whole / 60 % 60) {
        (0, 0) => format!("{whole} s"),
        (0, minutes) => format!("{minutes} min"),
        (hours, minutes) => format!("{hours} h {minutes} min"),
    }
}

/// Draws the body of a large screen: curves, strips of rollouts, tables and the camera picture.
fn large(shown: &ScreenContents<'_>, frame: &mut Frame, area: Rect) {
    let rows = [Constraint::Fill(3), Constraint::Length(STRIPS), Constraint::Fill(2)];
    let [top, middle, bottom] = Layout::vertical(rows).areas(area);
    both_curves(shown.run, frame, top);
    framed_strips(shown.run, frame, middle);
    // a cell shows two pixels, one above the other; the border takes a cell on each side
    let side = 2 * bottom.height.saturating_sub(2) + 2;
    let columns = [Constraint::Fill(1), Constraint::Length(side)];
    let [tables, right] = Layout::horizontal(columns).areas(bottom);
    both_tables(shown.run, frame, tables);
    let title = shown.picture.as_ref().map(|(title, _)| title.as_str());
    let block = Block::bordered().title(title.unwrap_or("no picture"));
    let inner = block.inner(right);
    frame.render_widget(block, right);
    if let Some((_, picture)) = &shown.picture {
        draw_picture(picture, fitted_picture_area(picture, inner), frame.buffer_mut());
    }
}

/// Draws the body of a medium screen: curves, strips of rollouts and tables.
fn medium(shown: &ScreenContents<'_>, frame: &mut Frame, area: Rect) {
    let rows = [Constraint::Fill(1), Constraint::Length(STRIPS), Constraint::Length(TABLES)];
    let [top, middle, bottom] = Layout::vertical(rows).areas(area);
    if area.width >= TWO_CURVES {
        both_curves(shown.run, frame, top);
    } else {
        curves::draw_curve(&curves::REWARD_CURVE, shown.run, frame, top);
    }
    framed_strips(shown.run, frame, middle);
    if area.width >= groups_table_width(shown.run) + DISTANCES {
        both_tables(shown.run, frame, bottom);
    } else {
        draw_groups_table(shown.run, frame, bottom);
    }
}

/// Draws the body of a small screen: strips of rollouts, and below them the reward if it fits.
fn small(shown: &ScreenContents<'_>, frame: &mut Frame, area: Rect) {
    let rows = [Constraint::Length(2), Constraint::Fill(1)];
    let [top, bottom] = Layout::vertical(rows).areas(area);
    draw_assignment_strips(shown.run, top, frame.buffer_mut());
    curves::draw_curve(&curves::REWARD_CURVE, shown.run, frame, bottom);
}

fn halves(area: Rect) -> [Rect; 2] {
    Layout::horizontal([Constraint::Fill(1); 2]).areas(area)
}

fn both_curves(run: &RunData, frame: &mut Frame, area: Rect) {
    for (figure, half) in [&curves::REWARD_CURVE, &curves::SUCCESS_CURVE].iter().zip(halves(area)) {
        curves::draw_curve(figure, run, frame, half);
    }
}

fn both_tables(run: &RunData, frame: &mut Frame, area: Rect) {
    let columns = [Constraint::Length(groups_table_width(run)), Constraint::Fill(1)];
    let [left, right] = Layout::horizontal(columns).areas(area);
    draw_groups_table(run, frame, left);
    distances::draw_policy_distances(run, frame, right);
}

fn framed_strips(run: &RunData, frame: &mut Frame, area: Rect) {
    let title = "group that ran and policy that was assigned, whole stream";
    let block = Block::bordered().title(title);
    let inner = block.inner(area);
    frame.render_widget(block, area);
    draw_assignment_strips(run, inner, frame.buffer_mut());
}
