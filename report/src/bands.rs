//! Learning curves of methods in one group: the mean over seeds, from the lowest to the highest.

use experiments::colours::{Stroke, stroke};

use super::efficiency::curve;
use super::method::MethodRuns;
use super::svg::{DOT, Drawing};
use experiments::evaluation::mean;

/// Ticks of shares.
const SHARES: [f64; 3] = [0.0, 0.5, 1.0];
/// Height of the panel (pixels).
const HEIGHT: f64 = 190.0;
/// Radius of the dots on the first method's line: dots of other methods show around them.
const FIRST_DOT: f64 = 2.2;

/// Success of all seeds of one method.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Moment {
    /// Decisions spent in the group.
    spent: f64,
    mean: f64,
    low: f64,
    high: f64,
}

/// Mean-action success of every method over the decisions spent in a group; none where no method
/// was scored at two moments of them. Of evaluations with as many decisions the first one counts.
/// The first method is the subject of a report: its line is wide, and the others are drawn upon it, so
/// that curves which coincide show both.
pub fn of_group(methods: &[MethodRuns], group: &str) -> Option<String> {
    let moments = |method: &MethodRuns| {
        let curves = method.runs.iter().map(|run| {
            let mut curve = curve(run, group);
            // while other groups run, nothing is spent
            curve.dedup_by_key(|(spent, _)| *spent);
            curve
        });
        moments(&curves.collect::<Vec<_>>())
    };
    let lines = methods.iter().enumerate().map(|(number, method)| Line {
        method,
        is_first: number == 0,
        stroke: stroke(number),
        moments: moments(method),
    });
    let lines: Vec<Line<'_>> = lines.collect();
    if !lines.iter().any(|line| line.moments.len() > 1) {
        return None;
    }
    let ends = lines.iter().filter_map(|line| line.moments.last());
    let end = ends.map(|moment| moment.spent).fold(0.0, f64::max);
    let mut drawing = Drawing::half(end, "decisions spent in the group");
    for line in &lines {
        drawing.legend(&line.method.name, &line.stroke);
    }
    drawing.panel(group, HEIGHT, [-0.03, 1.03], &SHARES);
    // no band lies upon a line, and the wide line lies below the narrow ones
    for line in &lines {
        line.draw_band(&mut drawing);
    }
    for line in &lines {
        line.draw(&mut drawing);
    }
    Some(drawing.finish(&format!("Success in {group}")))
}

/// The curve of one method.
struct Line<'a> {
    method: &'a MethodRuns,
    is_first: bool,
    stroke: Stroke,
    moments: Vec<Moment>,
}

impl Line<'_> {
    fn points(&self, figure: fn(&Moment) -> f64) -> Vec<(f64, f64)> {
        let moments = self.moments.iter();
        moments.map(|moment| (moment.spent, figure(moment))).collect()
    }

    fn draw_band(&self, drawing: &mut Drawing) {
        let (low, high) = (self.points(|m| m.low), self.points(|m| m.high));
        drawing.band(&low, &high, self.stroke.colour);
    }

    fn draw(&self, drawing: &mut Drawing) {
        let points = self.points(|m| m.mean);
        let radius = if self.is_first {
            drawing.wide_line(&points, &self.stroke);
            FIRST_DOT
        } else {
            drawing.line(&points, &self.stroke);
            DOT
        };
        let (name, seeds) = (&self.method.name, self.method.runs.len());
        for moment in &self.moments {
            let (spent, mean) = (moment.spent, moment.mean);
            let range = match seeds {
                1 => String::new(),
                _ => format!(" ({:.2} to {:.2}, {seeds} seeds)", moment.low, moment.high),
            };
            let title = format!("{name}, {spent:.0} decisions: {mean:.2}{range}");
            drawing.dot((spent, mean), radius, self.stroke.colour, &title);
        }
    }
}

/// The moments at which any seed was scored, as long as all of them have a curve there; between its
/// evaluations a seed lies on the line through them.
fn moments(curves: &[Vec<(f64, f64)>]) -> Vec<Moment> {
    let ends = curves.iter().map(|curve| curve.last().map_or(0.0, |p| p.0));
    let end = ends.fold(f64::INFINITY, f64::min);
    let mut spent: Vec<f64> = curves.concat().iter().map(|point| point.0).collect();
    spent.sort_by(f64::total_cmp);
    spent.dedup();
    spent.retain(|spent| *spent <= end);
    let moment = |spent: f64| {
        let at: Option<Vec<f64>> = curves.iter().map(|curve| at(curve, spent)).collect();
        let at = at?;
        Some(Moment {
            spent,
            mean: mean(&at),
            low: at.iter().copied().fold(f64::INFINITY, f64::min),
            high: at.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        })
    };
    spent.into_iter().filter_map(moment).collect()
}

/// The success of a curve at `spent`; none before it begins and after it ends.
fn at(curve: &[(f64, f64)], spent: f64) -> Option<f64> {
    let next = curve.iter().position(|point| point.0 >= spent)?;
    let (to, right) = curve[next];
    if to == spent {
        return Some(right);
    }
    let (from, left) = curve[next.checked_sub(1)?];
    Some(left + (right - left) * (spent - from) / (to - from))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::svg::read::{attribute, check_texts, of_class, tags};
    use experiments::presets::{Budget, Method};
    use experiments::{RolloutRow, RunData, ScoreRow};
    use itertools::Itertools;

    /// A method that was scored before and after one rollout.
    fn scored(number: usize) -> RunData {
        let score = |rollouts: usize| ScoreRow {
            rollouts,
            decisions: 500 * rollouts,
            group: "goal-reach".to_owned(),
            element: "identity".to_owned(),
            seen: true,
            episodes: 20,
            success: rollouts as f64 / 2.0,
            ..ScoreRow::default()
        };
        let name = format!("covers-with-a-name-{number}-seed0");
        RunData {
            rollouts: vec![RolloutRow {
                decisions: 500,
                group: "goal-reach".to_owned(),
                last_group: "goal-reach".to_owned(),
                ..RolloutRow::default()
            }],
            scores: [0, 1].map(score).to_vec(),
            ..RunData::empty(&name, Budget::Smoke.experiment(Method::Covers))
        }
    }

    fn drawing(methods: usize) -> String {
        let methods = MethodRuns::sort((0..methods).map(scored).collect()).unwrap();
        of_group(&methods, "goal-reach").unwrap()
    }

    /// Colour and dashes.
    fn strokes<'a>(svg: &'a str, class: &str) -> Vec<(Option<&'a str>, Option<&'a str>)> {
        let of_class = of_class(svg, class).into_iter();
        of_class
            .map(|(tag, _)| (attribute(tag, "stroke"), attribute(tag, "stroke-dasharray")))
            .collect()
    }

    #[test]
    fn any_number_of_methods_can_be_told_apart() {
        for methods in [1, 8, 11, 24] {
            let svg = drawing(methods);
            check_texts(&svg, methods);
            let keys = strokes(&svg, "line key");
            assert_eq!(keys.len(), methods);
            assert!(keys.iter().all_unique(), "{keys:?}");
            // lines have the strokes of their names
            let mut lines = strokes(&svg, "line wide");
            lines.extend(strokes(&svg, "line"));
            assert_eq!(lines, keys);
        }
    }

    #[test]
    fn the_first_method_is_wide_and_shows_on_both_sides_of_the_others() {
        let svg = drawing(11);
        let drawn: Vec<&str> = tags(&svg).into_iter().map(|(tag, _)| tag).collect();
        let is = |name: &'static str| move |tag: &&str| tag.starts_with(name);
        let first = drawn.iter().position(is("polyline")).unwrap();
        let line = drawn[first];
        assert_eq!(attribute(line, "class"), Some("line wide"));
        assert_eq!(attribute(line, "stroke"), Some(stroke(0).colour));
        let wide = |tag: &&&str| attribute(tag, "class") == Some("line wide");
        assert_eq!(drawn.iter().filter(wide).count(), 1);
        assert!(drawn.iter().rposition(is("polygon")).unwrap() < first);
        let widths = svg.split("stroke-width:").skip(1);
        let widths = widths.map(|rest| rest.split('}').next().unwrap().parse::<f64>().unwrap());
        assert!(widths.is_sorted_by(|narrow, wide| 2.0 * narrow < *wide));
    }

    #[test]
    fn bands_hold_every_seed_where_all_have_a_curve() {
        let curves = [
            vec![(0.0, 0.0), (100.0, 0.5), (200.0, 1.0)],
            vec![(0.0, 0.2), (50.0, 0.4), (150.0, 0.6)],
        ];
        let found = moments(&curves);
        let near = |one: f64, other: f64| (one - other).abs() < 1e-12;
        let expected = [(0.0, 0.0, 0.2), (50.0, 0.25, 0.4), (100.0, 0.5, 0.5), (150.0, 0.6, 0.75)];
        assert_eq!(found.len(), expected.len());
        for (moment, (spent, low, high)) in found.iter().zip(expected) {
            assert!(near(moment.spent, spent), "{moment:?}");
            assert!(near(moment.low, low) && near(moment.high, high), "{moment:?}");
            assert!(near(moment.mean, f64::midpoint(low, high)), "{moment:?}");
        }
        assert!(moments(&[vec![(0.0, 1.0)], vec![]]).is_empty());
    }
}
