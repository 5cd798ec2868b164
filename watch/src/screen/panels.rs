//! Panels of the screen other than curves and distances, and the colours that all panels share.

use envs::RGB_CHANNELS;
use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Rect};
use ratatui::style::{Color, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, Borders, Cell, Chart, Dataset, GraphType, Row, Table};

use experiments::RunData;
use experiments::colours::curve_rgb;
use experiments::evaluation;
use experiments::sheet::Picture;
use experiments::text::format_number;

use super::StreamProgress;

/// Luminance (0 to 255) of a background above which black text is easier to read than white.
const LIGHT: f64 = 110.0;
/// Upper end of the chart of distances over their thresholds; larger ratios are drawn there.
const LARGEST_RATIO: f64 = 4.0;
/// Width of the names in front of the strips of rollouts (terminal columns).
const NAMES: u16 = 7;

/// Returns the colour of a task group, by its place in the run's schedule, as in reports.
pub fn group_colour(run: &RunData, group: &str) -> Color {
    let number = run.experiment.schedule.group_index(group);
    number.map(curve_rgb).map_or(Color::Reset, |[r, g, b]| Color::Rgb(r, g, b))
}

/// Returns the colour of a policy, which is that of the task group for which it was created.
pub fn policy_colour(run: &RunData, policy: usize) -> Color {
    let group = run.group_of_policy(policy);
    group.map_or(Color::Reset, |group| group_colour(run, group))
}

/// Returns a style for text on `colour`: black or white, whichever is easier to read.
fn text_on(colour: Color) -> Style {
    let Color::Rgb(r, g, b) = colour else {
        return Style::new().reversed();
    };
    // weights of ITU-R BT.601
    let luminance = 0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b);
    let text = if luminance > LIGHT { Color::Black } else { Color::White };
    Style::new().bg(colour).fg(text)
}

/// Rows around those of the groups: the frame and the header.
const AROUND_ROWS: u16 = 3;
/// Widths of the columns of figures in the table of groups (terminal columns).
const FIGURES: [u16; 5] = [8, 6, 6, 7, 6];

/// Returns the width of the table of groups with its frame (terminal columns): all names fit.
pub fn groups_table_width(run: &RunData) -> u16 {
    // a gap before each figure, and the frame
    names_width(run) + FIGURES.iter().map(|width| width + 1).sum::<u16>() + 2
}

/// Returns the width of the groups' names with their squares (terminal columns).
fn names_width(run: &RunData) -> u16 {
    let names = run.experiment.schedule.groups.iter().map(|plan| plan.group.chars().count());
    // the bound keeps the width within u16
    2 + names.max().unwrap_or(0).min(99) as u16
}

/// Draws a table with a row for each group: its number of rollouts, policy, reward and success of
/// the latest of them, and the mean success of its variants in the latest evaluation. Where there
/// are more groups than lines, those that ran last are shown.
pub fn draw_groups_table(run: &RunData, frame: &mut Frame, area: Rect) {
    let mut groups: Vec<&str> =
        run.experiment.schedule.groups.iter().map(|p| &p.group[..]).collect();
    let (all, room) = (groups.len(), usize::from(area.height.saturating_sub(AROUND_ROWS)));
    let mut title = "groups, newest figures".to_owned();
    if all > room {
        let latest = |group: &&str| run.rollouts.iter().rposition(|row| row.group == *group);
        groups.sort_by_key(|group| std::cmp::Reverse(latest(group)));
        groups.truncate(room);
        title = format!("the latest {room} of {all} groups");
    }
    let rows = groups.into_iter().map(|group| group_row(run, group));
    let widths = std::iter::once(names_width(run)).chain(FIGURES).map(Constraint::Length);
    let header = ["group", "rollouts", "policy", "reward", "success", "scored"];
    let table = Table::new(rows, widths)
        .header(Row::new(header).style(Style::new().bold()))
        .block(Block::bordered().title(title));
    frame.render_widget(table, area);
}

fn group_row<'a>(run: &RunData, group: &'a str) -> Row<'a> {
    let own = || run.rollouts.iter().filter(|row| row.group == group);
    let newest = own().next_back();
    let policy = newest.map_or_else(|| "-".to_owned(), |row| row.policy.to_string());
    let scores = run.last_scores().filter(|row| row.group == group);
    let scores: Vec<f64> = scores.map(|row| row.success).collect();
    let evaluated = (!scores.is_empty()).then(|| evaluation::mean(&scores));
    let colour = group_colour(run, group);
    let letter = Span::styled(group_letter(run, group).to_string(), text_on(colour));
    let name = Line::from(vec![letter, Span::styled(format!(" {group}"), colour)]);
    Row::new([
        Cell::new(name),
        Cell::new(own().count().to_string()),
        Cell::new(policy),
        Cell::new(format_number(newest.and_then(|row| row.reward), 1)),
        Cell::new(format_number(newest.and_then(|row| row.success), 2)),
        Cell::new(format_number(evaluated, 2)),
    ])
}

/// Returns the letter of a group in the strips: the first of its name that no earlier group of the
/// schedule has.
fn group_letter(run: &RunData, group: &str) -> char {
    let mut taken = Vec::new();
    for plan in &run.experiment.schedule.groups {
        let mut letters = plan.group.chars().filter(char::is_ascii_alphabetic);
        let letter = letters.find(|letter| !taken.contains(letter)).unwrap_or('?');
        if plan.group == group {
            return letter;
        }
        taken.push(letter);
    }
    '?'
}

/// Draws two strips of all rollouts, one below the other: the group's letter on its colour, and the
/// policy's number on the colour of the group for which it was created. A rollout with two
/// colours was assigned to another group's policy. Where there are more rollouts than columns, a
/// column shows the first one of several.
pub fn draw_assignment_strips(run: &RunData, area: Rect, buffer: &mut Buffer) {
    let room = usize::from(area.width.saturating_sub(NAMES));
    let all = run.rollouts.len();
    let shown: Vec<_> =
        (0..all.min(room)).map(|column| &run.rollouts[column * all / all.min(room)]).collect();
    let mut lines = area.rows();
    let groups =
        shown.iter().map(|row| (group_letter(run, &row.group), group_colour(run, &row.group)));
    draw_strip("group", groups, lines.next(), buffer);
    let policies = shown.iter().map(|row| {
        // a cell has room for one character: digits, then letters
        let digit = char::from_digit((row.policy % 36) as u32, 36);
        (digit.unwrap_or('?'), policy_colour(run, row.policy))
    });
    draw_strip("policy", policies, lines.next(), buffer);
}

/// Draws a strip of rollouts: a name, and characters on their colours; nothing without a line left.
fn draw_strip(
    name: &str,
    characters: impl Iterator<Item = (char, Color)>,
    line: Option<Rect>,
    buffer: &mut Buffer,
) {
    let Some(line) = line else { return };
    buffer.set_stringn(line.x, line.y, name, usize::from(line.width), Color::Reset);
    let columns = line.x + NAMES.min(line.width)..line.right();
    for (x, (character, colour)) in columns.zip(characters) {
        buffer[(x, line.y)].set_char(character).set_style(text_on(colour));
    }
}

/// Draws the ratio of each distance to its threshold over the whole stream, as dots in the
/// policies' colours. With a permutation test's threshold, a dot above the line at 1 is a rollout
/// that is unlikely to be of the policy's group.
pub fn draw_distance_ratios(run: &RunData, frame: &mut Frame, area: Rect) {
    let newest = run.rollouts.last().map_or(0.0, |row| row.decisions as f64);
    let end = newest.max(StreamProgress::after_rollouts(run, 0).total_decisions as f64);
    let policies = run.rollouts.iter().map(|row| row.distances.len()).max();
    let dots: Vec<Vec<(f64, f64)>> =
        (0..policies.unwrap_or(0)).map(|policy| ratios(run, policy)).collect();
    let one = [(0.0, 1.0), (end, 1.0)];
    let line = Dataset::default()
        .marker(Marker::Braille)
        .graph_type(GraphType::Line)
        .style(Style::new().fg(Color::DarkGray))
        .data(&one);
    let sets = dots.iter().enumerate().map(|(policy, dots)| {
        Dataset::default()
            .marker(Marker::Braille)
            .style(Style::new().fg(policy_colour(run, policy)))
            .data(dots)
    });
    let chart = Chart::new(std::iter::once(line).chain(sets).collect())
        .block(Block::new().borders(Borders::TOP).title("W1 / threshold"))
        .x_axis(Axis::default().bounds([0.0, end]))
        .y_axis(Axis::default().bounds([0.0, LARGEST_RATIO]).labels(["0", "2", "4"]));
    frame.render_widget(chart, area);
}

/// Returns the decisions at each rollout, and its distance to one policy over the threshold.
fn ratios(run: &RunData, policy: usize) -> Vec<(f64, f64)> {
    let rows = run.rollouts.iter().filter_map(|row| {
        let threshold = run.policy_distance_thresholds(row).get(policy).copied()??;
        let ratio = row.distances.get(policy).copied()?? / threshold;
        Some((row.decisions as f64, ratio.min(LARGEST_RATIO))).filter(|_| ratio.is_finite())
    });
    rows.collect()
}

/// Returns the largest part of a terminal area that has the aspect ratio of a picture. A cell shows
/// two pixels, one above the other.
pub fn fitted_picture_area(picture: &Picture, area: Rect) -> Rect {
    let (width, height) = (picture.width.max(1), picture.height.max(1));
    let (across, down) = (usize::from(area.width), 2 * usize::from(area.height));
    let (across, down) = if across * height <= down * width {
        (across, across * height / width)
    } else {
        (down * width / height, down)
    };
    Rect::new(area.x, area.y, across as u16, (down / 2) as u16)
}

/// Draws a picture with half-block characters, two pixels in each. It is stretched to the area, so
/// the area should be that of [`fitted_picture_area`].
pub fn draw_picture(picture: &Picture, area: Rect, buffer: &mut Buffer) {
    let (across, down) = (usize::from(area.width), 2 * usize::from(area.height));
    for y in 0..down / 2 {
        for x in 0..across {
            let pixel = |row: usize| mean_colour(picture, [x, row], [across, down]);
            let cell = &mut buffer[(area.x + x as u16, area.y + y as u16)];
            cell.set_char('▀').set_fg(pixel(2 * y)).set_bg(pixel(2 * y + 1));
        }
    }
}

/// Returns the mean colour of the part of a picture that the pixel `at` covers, of a grid of
/// `of` = `[across, down]` pixels.
fn mean_colour(picture: &Picture, at: [usize; 2], of: [usize; 2]) -> Color {
    let range = |axis: usize, side: usize| {
        let from = at[axis] * side / of[axis];
        // at least one pixel, where the grid is finer than the picture
        from..((at[axis] + 1) * side / of[axis]).max(from + 1)
    };
    let columns = range(0, picture.width);
    let (mut sums, mut count) = ([0_usize; RGB_CHANNELS], 0);
    for y in range(1, picture.height) {
        let row = &picture.rgb[y * picture.width * RGB_CHANNELS..]
            [columns.start * RGB_CHANNELS..columns.end * RGB_CHANNELS];
        for pixel in row.chunks_exact(RGB_CHANNELS) {
            sums.iter_mut().zip(pixel).for_each(|(sum, &part)| *sum += usize::from(part));
            count += 1;
        }
    }
    let [r, g, b] = sums.map(|sum| (sum / count) as u8);
    Color::Rgb(r, g, b)
}
