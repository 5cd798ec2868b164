//! Success against how much is wrong.

use envs::TaskGroup;

use crate::colours::colour;
use crate::report::svg::Drawing;

use super::faults::Fault;
use super::table::{TrialScore, wilson};

/// What came of a sweep: each amount, and the trials with it.
pub type Swept = Vec<(f64, Vec<TrialScore>)>;

/// A row a trial.
pub fn rows(fault: Fault, swept: &Swept) -> String {
    let mut text = String::from(
        "fault,amount,group,variant,number,policy,fits,success,success_at_end,refused\n",
    );
    for (amount, scores) in swept {
        for score in scores {
            text += &format!(
                "{},{amount},{},{},{},{},{},{},{},{}\n",
                fault.name(),
                score.group.name(),
                score.element,
                score.number,
                score.policy,
                u8::from(score.fits),
                u8::from(score.success),
                u8::from(score.success_at_end),
                score.refused
            );
        }
    }
    text
}

/// Success of each group over the amount (SVG), with intervals of 95 % as bands.
pub fn figure(fault: Fault, swept: &Swept) -> String {
    let end = swept.last().map_or(0.0, |(amount, _)| *amount);
    let mut drawing = Drawing::half(end, fault.axis());
    let scores = swept.iter().flat_map(|(_, scores)| scores);
    let mut groups: Vec<TaskGroup> = Vec::new();
    for score in scores {
        if !groups.contains(&score.group) {
            groups.push(score.group);
        }
    }
    for (number, group) in groups.iter().enumerate() {
        drawing.legend(group.name(), colour(number));
    }
    drawing.panel("success", 220.0, [-0.03, 1.03], &[0.0, 0.5, 1.0]);
    for (number, &group) in groups.iter().enumerate() {
        curve(&mut drawing, colour(number), group, swept);
    }
    drawing.finish(&format!("Success against {}", fault.axis()))
}

/// The line of one group, its band, and a dot for each amount.
fn curve(drawing: &mut Drawing, colour: &str, group: TaskGroup, swept: &Swept) {
    let counts = swept.iter().map(|(amount, scores)| {
        let of_group: Vec<bool> = scores
            .iter()
            .filter(|score| score.group == group)
            .map(|score| score.success)
            .collect();
        let successes = of_group.iter().filter(|success| **success).count();
        (*amount, successes, of_group.len())
    });
    let counts: Vec<_> = counts.filter(|(_, _, trials)| *trials > 0).collect();
    let bound = |side: usize| -> Vec<(f64, f64)> {
        let points = counts.iter();
        let point = |&(amount, successes, trials): &_| (amount, wilson(successes, trials)[side]);
        points.map(point).collect()
    };
    drawing.band(&bound(0), &bound(1), colour);
    let share = |&(amount, successes, trials): &(f64, usize, usize)| {
        (amount, successes as f64 / trials as f64)
    };
    let points: Vec<_> = counts.iter().map(share).collect();
    drawing.line(&points, colour);
    for (point, (amount, successes, trials)) in points.into_iter().zip(&counts) {
        let title = format!("{} at {amount}: {successes} of {trials}", group.name());
        drawing.dot(point, colour, &title);
    }
}

#[cfg(test)]
mod tests {
    use symmetry::D2;

    use super::*;

    fn score(group: TaskGroup, success: bool) -> TrialScore {
        TrialScore {
            group,
            element: D2::FlipX,
            number: 3,
            policy: 1,
            fits: true,
            success,
            success_at_end: false,
            refused: 2,
        }
    }

    fn swept() -> Swept {
        let [reach, press] = [TaskGroup::GOAL_REACH, TaskGroup::BUTTON_PRESS];
        let trials = |successes| (0..4).map(move |n| score(press, n < successes));
        vec![
            (0.0, trials(4).chain([score(reach, true)]).collect()),
            (10.0, trials(1).chain([score(reach, false)]).collect()),
        ]
    }

    #[test]
    fn every_trial_has_a_row() {
        let text = rows(Fault::MaskGrowth, &swept());
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 1 + 10);
        assert_eq!(lines[1], "mask-growth,0,button-press,flip x,3,1,1,1,0,2");
        assert_eq!(lines[10], "mask-growth,10,goal-reach,flip x,3,1,1,0,0,2");
        let columns = lines[0].split(',').count();
        assert!(lines.iter().all(|line| line.split(',').count() == columns));
    }

    /// From (0, 1) to (10, 0.25): the axis is 440 pixels long from 64 on, and 220 high over
    /// -0.03 to 1.03.
    #[test]
    fn a_group_has_a_line_through_its_shares() {
        let text = figure(Fault::MaskGrowth, &swept());
        let y = |share: f64| 34.0 + 220.0 * (1.0 - (share + 0.03) / 1.06);
        let line = format!("points=\"64.0,{:.1} 504.0,{:.1}\"", y(1.0), y(0.25));
        assert!(text.contains(&line), "{line}: {text}");
        assert!(text.contains("button-press at 10: 1 of 4"));
        assert!(text.contains("growth of the mask (mm)"));
    }
}
