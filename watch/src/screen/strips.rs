//! Which group ran, and which policy was assigned, rollout by rollout.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Color;

use experiments::RunData;

use super::ink;

/// Columns that the names of the strips take.
const NAMES: u16 = 7;

/// Draws two strips, one below the other, of the newest rollouts for which there is room: the
/// group's first letter on its colour, and the policy's number on the colour of the group that it
/// was opened for. Where the colours differ, the learner was wrong.
pub fn draw(run: &RunData, area: Rect, buffer: &mut Buffer) {
    let room = usize::from(area.width.saturating_sub(NAMES));
    let newest = &run.rollouts[run.rollouts.len().saturating_sub(room)..];
    let mut lines = area.rows();
    let groups = newest.iter().map(|row| {
        let colour = ink::of_group(run, &row.group);
        (initial(&row.group), colour)
    });
    strip("group", groups, lines.next(), buffer);
    let policies = newest.iter().map(|row| {
        let colour = ink::of_policy(run, row.policy);
        (digit(row.policy), colour)
    });
    strip("policy", policies, lines.next(), buffer);
}

/// Draws a name and signs on colours in a line, where there is one.
fn strip(
    name: &str,
    signs: impl Iterator<Item = (char, Color)>,
    line: Option<Rect>,
    buffer: &mut Buffer,
) {
    let Some(line) = line else { return };
    buffer.set_stringn(line.x, line.y, name, usize::from(line.width), Color::Reset);
    let columns = line.x + NAMES.min(line.width)..line.right();
    for (x, (sign, colour)) in columns.zip(signs) {
        buffer[(x, line.y)].set_char(sign).set_style(ink::on(colour));
    }
}

fn initial(name: &str) -> char {
    name.chars().next().unwrap_or('?')
}

/// The last digit of a policy's number.
fn digit(policy: usize) -> char {
    char::from(b'0' + (policy % 10) as u8)
}
