//! Colours of groups, which are those of reports, and of policies: those of their groups.

use ratatui::style::{Color, Style};

use experiments::RunData;
use experiments::colours::rgb;

/// Luminance (of 255) above which black is read better than white.
const LIGHT: f64 = 110.0;

/// The colour of a group: that of its place in the schedule.
pub fn of_group(run: &RunData, group: &str) -> Color {
    let number = run.experiment.schedule.number(group);
    number.map_or(Color::Reset, numbered)
}

/// The colour of a policy: that of the group which it was opened for.
pub fn of_policy(run: &RunData, policy: usize) -> Color {
    let group = run.group_of(policy);
    group.map_or(Color::Reset, |group| of_group(run, group))
}

fn numbered(number: usize) -> Color {
    let [r, g, b] = rgb(number);
    Color::Rgb(r, g, b)
}

/// A sign on a colour, black or white, whichever is read better.
pub fn on(colour: Color) -> Style {
    let Color::Rgb(r, g, b) = colour else {
        return Style::new().reversed();
    };
    let luminance = 0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b);
    let sign = match luminance > LIGHT {
        true => Color::Black,
        false => Color::White,
    };
    Style::new().bg(colour).fg(sign)
}
