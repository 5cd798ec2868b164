//! Learning curves of methods in one group: the mean over seeds, from the lowest to the highest.

use crate::colours::colour;

use super::efficiency::curve;
use super::method::MethodRuns;
use super::statistics::mean;
use super::svg::Drawing;

/// Ticks of shares.
const SHARES: [f64; 3] = [0.0, 0.5, 1.0];
/// Height of the panel (pixels).
const HEIGHT: f64 = 190.0;

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
    let known: Vec<_> = methods.iter().map(|m| (m, moments(m))).collect();
    let learnt = |moments: &Vec<Moment>| moments.len() > 1;
    if !known.iter().any(|(_, moments)| learnt(moments)) {
        return None;
    }
    let ends = known.iter().filter_map(|(_, moments)| moments.last());
    let end = ends.map(|moment| moment.spent).fold(0.0, f64::max);
    let mut drawing = Drawing::half(end, "decisions spent in the group");
    for (number, (method, _)) in known.iter().enumerate() {
        drawing.legend(&method.name, colour(number));
    }
    drawing.panel(group, HEIGHT, [-0.03, 1.03], &SHARES);
    for (number, (method, moments)) in known.iter().enumerate() {
        draw(&mut drawing, method, moments, colour(number));
    }
    Some(drawing.finish(&format!("Success in {group}")))
}

fn draw(drawing: &mut Drawing, method: &MethodRuns, moments: &[Moment], colour: &str) {
    let line = |figure: fn(&Moment) -> f64| -> Vec<(f64, f64)> {
        let points = moments.iter().map(|moment| (moment.spent, figure(moment)));
        points.collect()
    };
    drawing.band(&line(|m| m.low), &line(|m| m.high), colour);
    drawing.line(&line(|m| m.mean), colour);
    let (name, seeds) = (&method.name, method.runs.len());
    for moment in moments {
        let (spent, mean) = (moment.spent, moment.mean);
        let range = match seeds {
            1 => String::new(),
            _ => format!(" ({:.2} to {:.2}, {seeds} seeds)", moment.low, moment.high),
        };
        let title = format!("{name}, {spent:.0} decisions: {mean:.2}{range}");
        drawing.dot((spent, mean), colour, &title);
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

    #[test]
    fn bands_hold_every_seed_where_all_have_a_curve() {
        let curves = [
            vec![(0.0, 0.0), (100.0, 0.5), (200.0, 1.0)],
            vec![(0.0, 0.2), (50.0, 0.4), (150.0, 0.6)],
        ];
        let found = moments(&curves);
        let near = |one: f64, other: f64| (one - other).abs() < 1e-12;
        let expected = [
            (0.0, 0.0, 0.2),
            (50.0, 0.25, 0.4),
            (100.0, 0.5, 0.5),
            (150.0, 0.6, 0.75),
        ];
        assert_eq!(found.len(), expected.len());
        for (moment, (spent, low, high)) in found.iter().zip(expected) {
            assert!(near(moment.spent, spent), "{moment:?}");
            assert!(
                near(moment.low, low) && near(moment.high, high),
                "{moment:?}"
            );
            assert!(near(moment.mean, f64::midpoint(low, high)), "{moment:?}");
        }
        assert!(moments(&[vec![(0.0, 1.0)], vec![]]).is_empty());
    }
}
