//! Charts of estimates with 95 % intervals, and performance profiles, as rliable draws them.

use experiments::colours::{LineStyle, curve_colour, curve_style};
use experiments::evaluation::mean;

use super::format::{bracketed_interval, score_text};
use super::method::MethodRuns;
use super::statistics::{ConfidenceInterval, MethodScores};
use super::svg::{SvgPlot, TEXT_COLOUR};

/// Height of one row of an interval chart (pixels).
const ROW: f64 = 24.0;
/// Margins of an interval chart (pixels): names on the left, figures on the right.
const SIDES: [f64; 2] = [140.0, 160.0];
/// Radius of the dot of an estimate (pixels).
const DOT: f64 = 5.0;
/// Number of steps between the thresholds of a performance profile.
const PROFILE_STEPS: u32 = 50;

/// Estimate of a statistic, such as a method's mean success, in `[0, 1]`, with its 95 % interval.
pub struct IntervalEstimate<'a> {
    /// Name of what is estimated, such as a method.
    pub name: &'a str,
    /// Estimate, in `[0, 1]`; NaN for a method that was not evaluated yet.
    pub value: f64,
    /// 95 % interval; `None` for fewer than two seeds, and for estimates without one.
    pub interval: Option<ConfidenceInterval>,
}

/// Draws estimates as an SVG chart with one row for each: a dot, its interval as a line, and both
/// as numbers. `first` is the number of the first one among all methods, which sets the colours;
/// `chance` is a value to compare with, drawn as a vertical line.
pub fn interval_svg(
    title: &str,
    axis: &'static str,
    estimates: &[IntervalEstimate<'_>],
    first: usize,
    chance: Option<f64>,
) -> String {
    let mut drawing = SvgPlot::new_half_width(1.0, axis).with_side_margins(SIDES);
    let last = estimates.len().saturating_sub(1) as f64;
    let bounds = [-0.6, last + 0.6];
    drawing.begin_panel("", ROW * (last + 1.2), bounds, &[]);
    if let Some(chance) = chance {
        let line = bounds.map(|y| (chance, y));
        drawing.add_line(&line, &LineStyle { colour: TEXT_COLOUR, dashes: "3 3".to_owned() });
    }
    for (number, IntervalEstimate { name, value, interval }) in estimates.iter().enumerate() {
        let (y, colour) = (last - number as f64, curve_colour(first + number));
        let figure = format!("{value:.3}{}", bracketed_interval(*interval, 2));
        let figure = score_text(*value, figure);
        if let Some(ConfidenceInterval { low, high }) = interval {
            drawing.add_wide_line(&[(*low, y), (*high, y)], &LineStyle::solid(colour));
        }
        if !value.is_nan() {
            drawing.add_dot((*value, y), DOT, colour, &format!("{name}: {figure}"));
        }
        drawing.add_row_label(y, name);
        drawing.add_row_value(y, &figure);
    }
    drawing.into_svg(title)
}

/// Draws the success of each method as an SVG chart; for a single method, its success in each group
/// and over all groups.
pub fn success_svg(methods: &[MethodRuns], groups: &[String]) -> String {
    let [method] = methods else {
        return statistic_by_method_svg("Success of all methods", "success", methods, groups, mean);
    };
    let alone = groups.iter().map(|group| (group.as_str(), std::slice::from_ref(group)));
    let rows = alone.chain([("all groups", groups)]);
    let rows = rows.map(|(name, averaged)| estimate(name, method, averaged, mean));
    let title = format!("Success of {}", method.name);
    interval_svg(&title, "success", &rows.collect::<Vec<_>>(), 0, None)
}

/// Draws a statistic of each method's success, such as the mean, as an SVG chart with 95 %
/// intervals.
pub fn statistic_by_method_svg(
    title: &str,
    axis: &'static str,
    methods: &[MethodRuns],
    groups: &[String],
    statistic: fn(&[f64]) -> f64,
) -> String {
    let rows = methods.iter().map(|method| estimate(&method.name, method, groups, statistic));
    interval_svg(title, axis, &rows.collect::<Vec<_>>(), 0, None)
}

fn estimate<'a>(
    name: &'a str,
    method: &MethodRuns,
    groups: &[String],
    statistic: fn(&[f64]) -> f64,
) -> IntervalEstimate<'a> {
    let scores = method.success(groups);
    let interval = scores.bootstrap_interval(statistic);
    IntervalEstimate { name, value: scores.pooled_statistic(statistic), interval }
}

/// Draws performance profiles of `methods`, whose scores are in the same order, as SVG: for each
/// threshold the share of runs and groups whose success is above it, with a band of pointwise 95 %
/// intervals (Agarwal et al., NeurIPS 2021).
pub fn performance_profile_svg(methods: &[MethodRuns], scores: &[MethodScores]) -> String {
    let mut drawing = SvgPlot::new_half_width(1.0, "success of a run in a group is above")
        .with_side_margins([64.0, 120.0]);
    for (number, method) in methods.iter().enumerate() {
        drawing.add_legend_entry(&method.name, &curve_style(number));
    }
    drawing.begin_panel("share of runs and groups", 190.0, [-0.03, 1.03], &[0.0, 0.5, 1.0]);
    let thresholds = (0..=PROFILE_STEPS).map(|step| f64::from(step) / f64::from(PROFILE_STEPS));
    let thresholds: Vec<f64> = thresholds.collect();
    let profiles: Vec<_> =
        scores.iter().map(|scores| scores.performance_profile(&thresholds)).collect();
    let line = |values: &mut dyn Iterator<Item = f64>| -> Vec<(f64, f64)> {
        thresholds.iter().copied().zip(values).collect()
    };
    for (number, profile) in profiles.iter().enumerate() {
        let bounds = |bound: fn(&ConfidenceInterval) -> f64| {
            line(&mut profile.iter().filter_map(|point| point.1.as_ref().map(bound)))
        };
        let [low, high] = [bounds(|interval| interval.low), bounds(|interval| interval.high)];
        drawing.add_band(&low, &high, curve_colour(number));
    }
    for (number, profile) in profiles.iter().enumerate() {
        let shares = line(&mut profile.iter().map(|point| point.0));
        drawing.add_line(&shares, &curve_style(number));
    }
    drawing.into_svg("Performance profiles")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::svg::read::{attribute, number, of_class, tags};

    #[test]
    fn an_interval_spans_its_bounds_and_holds_its_dot() {
        let wide = Some(ConfidenceInterval { low: 0.25, high: 1.0 });
        let estimate = |name, value, interval| IntervalEstimate { name, value, interval };
        let rows = [estimate("a", 0.5, wide), estimate("b", 1.0, None)];
        let svg = interval_svg("title", "success", &rows, 1, Some(0.5));
        let [(line, _)] = of_class(&svg, "line wide")[..] else { panic!("{svg}") };
        let dots: Vec<&str> = tags(&svg)
            .into_iter()
            .map(|tag| tag.0)
            .filter(|tag| tag.starts_with("circle"))
            .collect();
        let y = number(dots[0], "cy");
        // the axis has 440 pixels, from 140 on
        assert_eq!(attribute(line, "points"), Some(&*format!("250.0,{y:.1} 580.0,{y:.1}")));
        assert_eq!((number(dots[0], "cx"), number(dots[1], "cx")), (360.0, 580.0));
        assert!(y < number(dots[1], "cy"), "the first estimate is on top");
        assert!(dots[0].contains(curve_colour(1)) && dots[1].contains(curve_colour(2)), "{dots:?}");
        assert!(svg.contains("0.500 [0.25, 1.00]") && svg.contains(">1.000</text>"), "{svg}");
    }
}
