//! Tables and figures of success against the amount of a fault.

use envs::TaskGroup;

use experiments::colours::{LineStyle, curve_style};
use report::svg::{DOT_RADIUS, SvgPlot};

use super::faults::SimulatedFault;
use super::table::{TRIAL_CSV_HEADER, TrialResult, trial_csv_row, wilson_interval};

/// Height of the panel of one task group in a figure (pixels).
const HEIGHT: f64 = 100.0;
/// Shares of success at the lower and the upper edge of a panel, with room for dots at 0 and 1.
const BOUNDS: [f64; 2] = [-0.05, 1.05];

/// Results of a sweep over the amounts of a fault: each amount with its trials.
pub type FaultSweepResults = Vec<(f64, Vec<TrialResult>)>;

/// Returns a table (CSV) of the trials of a sweep over a fault's amounts, a row for each trial.
pub fn fault_sweep_csv(fault: SimulatedFault, swept: &FaultSweepResults) -> String {
    let mut text = format!("fault,amount,{TRIAL_CSV_HEADER}\n");
    for (amount, scores) in swept {
        for score in scores {
            text += &format!("{},{amount},{}\n", fault.name(), trial_csv_row(score));
        }
    }
    text
}

/// Draws the success of each group over the amount of a fault (SVG), a panel for each group, with
/// intervals of 95 % as bands.
pub fn fault_sweep_svg(
    fault: SimulatedFault,
    groups: &[TaskGroup],
    swept: &FaultSweepResults,
) -> String {
    let end = swept.last().map_or(0.0, |(amount, _)| *amount);
    let mut drawing = SvgPlot::new_half_width(end, fault.axis_label());
    for (number, group) in groups.iter().enumerate() {
        drawing.begin_panel(group.name(), HEIGHT, BOUNDS, &[0.0, 0.5, 1.0]);
        curve(&mut drawing, &curve_style(number), *group, swept);
    }
    drawing.into_svg(&format!("Success against {}", fault.axis_label()))
}

/// Draws the success of one group: a line, a band for its interval, and a dot for each amount.
fn curve(drawing: &mut SvgPlot, stroke: &LineStyle, group: TaskGroup, swept: &FaultSweepResults) {
    let counts = swept.iter().map(|(amount, scores)| {
        let of_group: Vec<bool> =
            scores.iter().filter(|score| score.group == group).map(|score| score.success).collect();
        let successes = of_group.iter().filter(|success| **success).count();
        (*amount, successes, of_group.len())
    });
    // a share of no trials is no point
    let counts: Vec<_> = counts.filter(|(_, _, trials)| *trials > 0).collect();
    let bound = |side: usize| -> Vec<(f64, f64)> {
        let points = counts.iter();
        let point =
            |&(amount, successes, trials): &_| (amount, wilson_interval(successes, trials)[side]);
        points.map(point).collect()
    };
    drawing.add_band(&bound(0), &bound(1), stroke.colour);
    let share = |&(amount, successes, trials): &(f64, usize, usize)| {
        (amount, successes as f64 / trials as f64)
    };
    let points: Vec<_> = counts.iter().map(share).collect();
    drawing.add_line(&points, stroke);
    for (point, (amount, successes, trials)) in points.into_iter().zip(&counts) {
        let title = format!("{} at {amount}: {successes} of {trials}", group.name());
        drawing.add_dot(point, DOT_RADIUS, stroke.colour, &title);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::tests::score;

    const GROUPS: [TaskGroup; 2] = [TaskGroup::GOAL_REACH, TaskGroup::BUTTON_PRESS];

    fn swept() -> FaultSweepResults {
        let [reach, press] = GROUPS;
        let trials = |successes| (0..4).map(move |n| score(press, 3, n < successes));
        vec![
            (0.0, trials(4).chain([score(reach, 3, true)]).collect()),
            (10.0, trials(1).chain([score(reach, 3, false)]).collect()),
        ]
    }

    #[test]
    fn every_trial_has_a_row() {
        let text = fault_sweep_csv(SimulatedFault::MaskMargin, &swept());
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 1 + 10);
        assert_eq!(lines[1], "mask-growth,0,button-press,flip x,3,1,1,1,0,2");
        assert_eq!(lines[10], "mask-growth,10,goal-reach,flip x,3,1,1,0,0,2");
        let columns = lines[0].split(',').count();
        assert!(lines.iter().all(|line| line.split(',').count() == columns));
    }

    /// From (0, 1) to (10, 0.25): the axis is 440 pixels long from 64 on, and the second panel
    /// begins 14 below the first.
    #[test]
    fn a_group_has_a_line_through_its_shares() {
        let text = fault_sweep_svg(SimulatedFault::MaskMargin, &GROUPS, &swept());
        let y = |share: f64| 34.0 + HEIGHT + 14.0 + HEIGHT * (1.0 - (share + 0.05) / 1.1);
        let line = format!("points=\"64.0,{:.1} 504.0,{:.1}\"", y(1.0), y(0.25));
        assert!(text.contains(&line), "{line}: {text}");
        assert!(text.contains("button-press at 10: 1 of 4"));
        assert!(text.contains("growth of the mask (mm)"));
    }
}
