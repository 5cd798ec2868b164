//! What a screen shows of a run, as much as there is room for.

use std::time::Duration;

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Paragraph};

use experiments::RunData;
use experiments::sheet::Picture;
use experiments::text::number;

use super::{Pace, curves, distances, groups, ink, picture, strips};

/// Least columns and rows of a screen that shows every panel. Long names are cut at this width.
const WHOLE: [u16; 2] = [100, 30];
/// Least rows of what is not head or foot, where there are tables.
const MOST: u16 = 20;
/// Least columns at which curves stand beside each other.
const BESIDE: u16 = 70;
/// Rows of the tables, and of the strips with their frame.
const TABLES: u16 = 8;
const STRIPS: u16 = 4;

/// What is to be shown.
pub struct Shown<'a> {
    pub run: &'a RunData,
    pub finished: bool,
    /// How long nothing has come.
    pub silence: Option<Duration>,
    /// A picture and what it is of.
    pub picture: Option<(String, Picture)>,
    /// What keys do, or what happens because of one.
    pub keys: &'a str,
}

/// Draws a whole screen.
pub fn draw(shown: &Shown<'_>, frame: &mut Frame) {
    let area = frame.area();
    let rows = [2, 0, 1].map(Constraint::Length);
    let rows = [rows[0], Constraint::Fill(1), rows[2]];
    let [head, body, foot] = Layout::vertical(rows).areas(area);
    frame.render_widget(Paragraph::new(headline(shown).to_vec()), head);
    let [width, height] = WHOLE;
    match (area.width >= width && area.height >= height, body.height) {
        (true, _) => everything(shown, frame, body),
        (false, MOST..) => most(shown, frame, body),
        (false, _) => least(shown, frame, body),
    }
    frame.render_widget(Line::from(footline(shown)).style(Style::new().dim()), foot);
}

/// The run's name and what happens now, and how far it is.
fn headline<'a>(shown: &Shown<'a>) -> [Line<'a>; 2] {
    let run = shown.run;
    let name = Span::styled(&run.name, Style::new().bold());
    let pace = Pace::after(run, run.rollouts.len());
    let now = match (shown.finished, run.rollouts.last()) {
        (true, _) => vec![Span::raw("finished")],
        (false, Some(_)) if pace.done >= pace.stream => vec![Span::raw("last evaluation")],
        (false, None) => vec![Span::raw("begins")],
        (false, Some(row)) => vec![
            Span::styled(row.last_group.clone(), ink::of_group(run, &row.last_group)),
            Span::raw(", policy "),
            Span::styled(row.policy.to_string(), ink::of_policy(run, row.policy)),
        ],
    };
    let first = [name, Span::raw("  ")].into_iter().chain(now).collect();
    [first, Line::from(progress(shown))]
}

fn progress(shown: &Shown<'_>) -> String {
    let run = shown.run;
    let pace = Pace::after(run, run.rollouts.len());
    let done = pace.done;
    let share = done.saturating_mul(100) / pace.stream.max(1);
    let left = match (shown.finished, pace.seconds_left) {
        (true, _) => "0 s".to_owned(),
        (false, seconds) => seconds.map_or_else(|| "-".to_owned(), duration),
    };
    let rate = number(pace.decisions_per_second, 0);
    let stream = pace.stream;
    format!("{share} %, {left} left, {rate} decisions/s, {done} of {stream} decisions")
}

fn footline(shown: &Shown<'_>) -> String {
    let silence = shown.silence.filter(|_| !shown.finished);
    let silence = silence.map(|silence| silence.as_secs_f64()).map(duration);
    let newest = silence.map_or_else(String::new, |age| format!("  newest row {age} old"));
    format!("{}{newest}", shown.keys)
}

/// Seconds as people say them.
fn duration(seconds: f64) -> String {
    let whole = seconds as u64;
    match (whole / 3600, whole / 60 % 60) {
        (0, 0) => format!("{whole} s"),
        (0, minutes) => format!("{minutes} min"),
        (hours, minutes) => format!("{hours} h {minutes} min"),
    }
}

/// Curves, strips, tables and the picture.
fn everything(shown: &Shown<'_>, frame: &mut Frame, area: Rect) {
    let rows = [3, 0, 2].map(Constraint::Fill);
    let rows = [rows[0], Constraint::Length(STRIPS), rows[2]];
    let [top, middle, bottom] = Layout::vertical(rows).areas(area);
    both_curves(shown.run, frame, top);
    framed_strips(shown.run, frame, middle);
    // two pixels of a picture are as high as one cell
    let side = 2 * bottom.height.saturating_sub(2) + 2;
    let columns = [Constraint::Fill(1), Constraint::Length(side)];
    let [tables, right] = Layout::horizontal(columns).areas(bottom);
    both_tables(shown.run, frame, tables);
    let title = shown.picture.as_ref().map(|(title, _)| title.as_str());
    let block = Block::bordered().title(title.unwrap_or("no picture"));
    let inner = block.inner(right);
    frame.render_widget(block, right);
    if let Some((_, picture)) = &shown.picture {
        picture::draw(picture, picture::fit(picture, inner), frame.buffer_mut());
    }
}

/// Curves, strips and tables.
fn most(shown: &Shown<'_>, frame: &mut Frame, area: Rect) {
    let rows = [0, STRIPS, TABLES].map(Constraint::Length);
    let rows = [Constraint::Fill(1), rows[1], rows[2]];
    let [top, middle, bottom] = Layout::vertical(rows).areas(area);
    match area.width >= BESIDE {
        true => both_curves(shown.run, frame, top),
        false => curves::draw(&curves::REWARD, shown.run, frame, top),
    }
    framed_strips(shown.run, frame, middle);
    match area.width >= WHOLE[0] {
        true => both_tables(shown.run, frame, bottom),
        false => groups::draw(shown.run, frame, bottom),
    }
}

/// Strips, and a curve below them where there is room.
fn least(shown: &Shown<'_>, frame: &mut Frame, area: Rect) {
    let rows = [Constraint::Length(2), Constraint::Fill(1)];
    let [top, bottom] = Layout::vertical(rows).areas(area);
    strips::draw(shown.run, top, frame.buffer_mut());
    curves::draw(&curves::REWARD, shown.run, frame, bottom);
}

fn halves(area: Rect) -> [Rect; 2] {
    Layout::horizontal([Constraint::Fill(1); 2]).areas(area)
}

fn both_curves(run: &RunData, frame: &mut Frame, area: Rect) {
    for (figure, half) in [&curves::REWARD, &curves::SUCCESS].iter().zip(halves(area)) {
        curves::draw(figure, run, frame, half);
    }
}

fn both_tables(run: &RunData, frame: &mut Frame, area: Rect) {
    let [left, right] = halves(area);
    groups::draw(run, frame, left);
    distances::draw(run, frame, right);
}

fn framed_strips(run: &RunData, frame: &mut Frame, area: Rect) {
    let title = "group that ran and policy that was assigned, rollout by rollout";
    let block = Block::bordered().title(title);
    let inner = block.inner(area);
    frame.render_widget(block, area);
    strips::draw(run, inner, frame.buffer_mut());
}
