//! Learning curves of methods, in one group or over the stream: mean over seeds, and a band from
//! the lowest seed to the highest.

use experiments::colours::{LineStyle, curve_style};

use super::curves::{decisions_axis_label, stream_success_curve};
use super::efficiency::success_curve;
use super::method::MethodRuns;
use super::svg::{DOT_RADIUS, SvgPlot};
use experiments::RunData;
use experiments::evaluation::mean;

const SUCCESS_TICKS: [f64; 3] = [0.0, 0.5, 1.0];
/// Height of the panel with the learning curves (pixels).
const HEIGHT: f64 = 190.0;
/// Margins left and right of the panel (pixels), with the names of the curves on the right.
const SIDES: [f64; 2] = [64.0, 160.0];
/// Radius of the dots on the first method's line (pixels): dots of other methods, which are drawn
/// with [`DOT_RADIUS`], show around them.
const FIRST_DOT: f64 = 2.2;

/// Largest number of points of a curve of success in training.
const MAX_TRAINING_POINTS: usize = 50;

/// Point of a learning curve: success over the seeds of one method after a number of decisions.
#[derive(Clone, Copy, Debug, PartialEq)]
struct CurvePoint {
    /// Number of training decisions, in the task group or in all.
    spent: f64,
    mean: f64,
    low: f64,
    high: f64,
}

/// Draws learning curves in a task group as SVG: each method's success with mean actions over the
/// decisions spent in the group; `None` if no method has scores at two numbers of decisions. The
/// first of several evaluations with equally many decisions counts.
pub fn group_learning_curves_svg(methods: &[MethodRuns], group: &str) -> Option<String> {
    let curve = |run: &RunData| {
        let mut curve = success_curve(run, group);
        // evaluations while other groups run add no decisions in this one
        curve.dedup_by_key(|(spent, _)| *spent);
        curve
    };
    curves_svg(methods, group, "decisions spent in the group", curve)
}

/// Draws learning curves over the stream as SVG: each method's success with mean actions, averaged
/// over all groups; `None` if no method was scored twice.
pub fn stream_learning_curves_svg(methods: &[MethodRuns]) -> Option<String> {
    curves_svg(methods, "all groups", "decisions", stream_success_curve)
}

/// Draws curves of success in training as SVG, for methods that were not scored twice: each
/// method's success while it explores, averaged over stretches of rollouts; `None` if there are
/// fewer than two.
pub fn training_curves_svg(methods: &[MethodRuns]) -> Option<String> {
    curves_svg(methods, "training", "decisions", training_success_curve)
}

/// Returns a point (training decisions at the end, mean success) for each stretch of a run's
/// rollouts, of which there are at most [`MAX_TRAINING_POINTS`]; all but the last are equally long.
fn training_success_curve(run: &RunData) -> Vec<(f64, f64)> {
    let rows = run.rollouts.iter().filter_map(|row| Some((row.decisions as f64, row.success?)));
    let (decisions, successes) = rows.unzip::<_, _, Vec<f64>, Vec<f64>>();
    let length = decisions.len().div_ceil(MAX_TRAINING_POINTS).max(1);
    let ends = decisions.chunks(length).filter_map(|stretch| stretch.last().copied());
    ends.zip(successes.chunks(length).map(mean)).collect()
}

/// Draws one curve for each method: `curve` of its runs, averaged.
///
/// The first method is the subject of a report. Its line is wide and the others are drawn upon it,
/// so curves that coincide show both.
fn curves_svg(
    methods: &[MethodRuns],
    name: &str,
    axis: &str,
    curve: impl Fn(&RunData) -> Vec<(f64, f64)>,
) -> Option<String> {
    let lines = methods.iter().enumerate().map(|(number, method)| {
        let curves: Vec<_> = method.runs.iter().map(&curve).collect();
        Line {
            method,
            is_first: number == 0,
            stroke: curve_style(number),
            points: mean_curve(&curves),
            seed_count: curves.iter().filter(|points| !points.is_empty()).count(),
        }
    });
    let lines: Vec<Line<'_>> = lines.collect();
    if !lines.iter().any(|line| line.points.len() > 1) {
        return None;
    }
    let last_points = lines.iter().filter_map(|line| line.points.last());
    let end = last_points.map(|point| point.spent).fold(0.0, f64::max);
    let axis = decisions_axis_label(axis, &methods[0].runs[0]);
    let mut drawing = SvgPlot::new_half_width(end, &axis).with_side_margins(SIDES);
    for line in &lines {
        drawing.add_legend_entry(&line.method.name, &line.stroke);
    }
    // 3 % of room on either side keeps dots at 0 and 1 inside the frame
    drawing.begin_panel(name, HEIGHT, [-0.03, 1.03], &SUCCESS_TICKS);
    // the order matters: no band covers a line, and the wide line lies below the narrow ones
    for line in &lines {
        line.draw_band(&mut drawing);
    }
    for line in &lines {
        line.draw(&mut drawing);
    }
    let ends = lines.iter().filter_map(|line| {
        let last = line.points.last()?;
        Some((line.method.name.as_str(), (last.spent, last.mean), &line.stroke))
    });
    drawing.add_curve_labels(&ends.collect::<Vec<_>>());
    Some(drawing.into_svg(&format!("Success in {name}")))
}

/// Learning curve of one method.
struct Line<'a> {
    method: &'a MethodRuns,
    is_first: bool,
    stroke: LineStyle,
    points: Vec<CurvePoint>,
    /// Number of seeds that have a curve: those that the points are means over.
    seed_count: usize,
}

impl Line<'_> {
    /// Returns decisions and one statistic of the success for each point of the curve.
    fn coordinates(&self, statistic: fn(&CurvePoint) -> f64) -> Vec<(f64, f64)> {
        self.points.iter().map(|point| (point.spent, statistic(point))).collect()
    }

    fn draw_band(&self, drawing: &mut SvgPlot) {
        let (low, high) = (self.coordinates(|p| p.low), self.coordinates(|p| p.high));
        drawing.add_band(&low, &high, self.stroke.colour);
    }

    fn draw(&self, drawing: &mut SvgPlot) {
        let points = self.coordinates(|point| point.mean);
        let radius = if self.is_first {
            drawing.add_wide_line(&points, &self.stroke);
            FIRST_DOT
        } else {
            drawing.add_line(&points, &self.stroke);
            DOT_RADIUS
        };
        let (name, seeds) = (&self.method.name, self.seed_count);
        for &CurvePoint { spent, mean, low, high } in &self.points {
            let range = match seeds {
                1 => String::new(),
                _ => format!(" ({low:.2} to {high:.2}, {seeds} seeds)"),
            };
            let title = format!("{name}, {spent:.0} decisions: {mean:.2}{range}");
            drawing.add_dot((spent, mean), radius, self.stroke.colour, &title);
        }
    }
}

/// Returns the mean learning curve over seeds: a point for every number of decisions at which any
/// seed was scored, as far as all seeds with a curve have one. Seeds are interpolated linearly
/// between their evaluations.
fn mean_curve(curves: &[Vec<(f64, f64)>]) -> Vec<CurvePoint> {
    let curves: Vec<_> = curves.iter().filter(|curve| !curve.is_empty()).cloned().collect();
    let ends = curves.iter().map(|curve| curve.last().map_or(0.0, |p| p.0));
    let end = ends.fold(f64::INFINITY, f64::min);
    let mut spent: Vec<f64> = curves.concat().iter().map(|point| point.0).collect();
    spent.sort_by(f64::total_cmp);
    spent.dedup();
    spent.retain(|spent| *spent <= end);
    let point = |decisions: f64| {
        let seeds = curves.iter().map(|curve| success_at(curve, decisions));
        let seeds = seeds.collect::<Option<Vec<f64>>>()?;
        Some(CurvePoint {
            spent: decisions,
            mean: mean(&seeds),
            low: seeds.iter().copied().fold(f64::INFINITY, f64::min),
            high: seeds.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        })
    };
    spent.into_iter().filter_map(point).collect()
}

/// Returns the success of a learning curve at `spent` decisions, interpolated; `None` before the
/// curve begins and after it ends.
fn success_at(curve: &[(f64, f64)], spent: f64) -> Option<f64> {
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
    use crate::fixtures::{run, score};
    use crate::svg::read::{attribute, check_texts, of_class, tags};
    use experiments::presets::Method;
    use itertools::Itertools;

    /// Returns a run that was scored before and after one rollout.
    fn scored(number: usize) -> RunData {
        let score = |rollouts: usize| score(rollouts, "goal-reach", rollouts as f64 / 2.0);
        RunData {
            name: format!("covers-with-a-name-{number}-seed0"),
            scores: [0, 1].map(score).to_vec(),
            ..run(Method::Covers, &[("goal-reach", 0)])
        }
    }

    fn drawing(methods: usize) -> String {
        let methods = MethodRuns::group_by_method((0..methods).map(scored).collect()).unwrap();
        group_learning_curves_svg(&methods, "goal-reach").unwrap()
    }

    /// Returns colour and dashes of each element of a class.
    fn strokes<'a>(svg: &'a str, class: &str) -> Vec<(Option<&'a str>, Option<&'a str>)> {
        let of_class = of_class(svg, class).into_iter();
        of_class
            .map(|(tag, _)| (attribute(tag, "stroke"), attribute(tag, "stroke-dasharray")))
            .collect()
    }

    #[test]
    fn a_seed_without_evaluations_does_not_hide_the_others() {
        let curves = [vec![(0.0, 0.0), (500.0, 1.0)], Vec::new()];
        let means: Vec<f64> = mean_curve(&curves).iter().map(|point| point.mean).collect();
        assert_eq!(means, [0.0, 1.0]);
    }

    #[test]
    fn long_training_is_averaged_over_stretches_of_rollouts() {
        let mut long = run(Method::Covers, &[("goal-reach", 0); 101]);
        for (number, row) in long.rollouts.iter_mut().enumerate() {
            row.success = Some((number % 3) as f64 / 2.0);
        }
        let curve = training_success_curve(&long);
        assert_eq!(curve[..2], [(300.0, 0.5), (600.0, 0.5)]);
        // two rollouts are left
        assert_eq!((curve.len(), curve[33]), (34, (10_100.0, 0.25)));
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
        assert_eq!(attribute(line, "stroke"), Some(curve_style(0).colour));
        let wide = |tag: &&&str| attribute(tag, "class") == Some("line wide");
        assert_eq!(drawn.iter().filter(wide).count(), 1);
        assert!(drawn.iter().rposition(is("polygon")).unwrap() < first);
        let widths = svg.split("stroke-width:").skip(1);
        let widths = widths.map(|rest| rest.split('}').next().unwrap().parse::<f64>().unwrap());
        assert!(widths.is_sorted_by(|thin, thick| 2.0 * thin < *thick));
    }

    #[test]
    fn bands_hold_every_seed_where_all_have_a_curve() {
        let curves = [
            vec![(0.0, 0.0), (100.0, 0.5), (200.0, 1.0)],
            vec![(0.0, 0.2), (50.0, 0.4), (150.0, 0.6)],
        ];
        let found = mean_curve(&curves);
        let near = |one: f64, other: f64| (one - other).abs() < 1e-12;
        let expected = [(0.0, 0.0, 0.2), (50.0, 0.25, 0.4), (100.0, 0.5, 0.5), (150.0, 0.6, 0.75)];
        assert_eq!(found.len(), expected.len());
        for (point, (spent, low, high)) in found.iter().zip(expected) {
            assert!(near(point.spent, spent), "{point:?}");
            assert!(near(point.low, low) && near(point.high, high), "{point:?}");
            assert!(near(point.mean, f64::midpoint(low, high)), "{point:?}");
        }
        assert!(mean_curve(&[Vec::new(), Vec::new()]).is_empty());
    }
}
