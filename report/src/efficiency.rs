//! Sample efficiency of methods: areas under learning curves, and decisions until a group is
//! solved.

use super::comparison::MethodComparison;
use super::format::{bracketed_interval, empty_cell, method_cell};
use super::method::MethodRuns;
use super::statistics::{MethodScores, median, quantile};
use super::table::ReportTable;
use experiments::RunData;
use experiments::evaluation::mean;

/// Minimum success rate, in `[0, 1]`, at which a task group counts as solved.
pub const SOLVED_SUCCESS: f64 = 0.9;

/// Sample efficiency of one run in one task group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleEfficiency {
    /// Area under the curve of success over the decisions spent in the group, divided by these
    /// decisions, in `[0, 1]`.
    pub area_under_curve: f64,
    /// Decisions spent in the group before the first evaluation with a success of at least
    /// [`SOLVED_SUCCESS`]; infinite if there is none.
    pub decisions_to_solve: f64,
    /// Decisions spent in the group before the first evaluation from which on every one reaches
    /// [`SOLVED_SUCCESS`]; infinite if the last one does not.
    pub decisions_to_stay_solved: f64,
}

impl SampleEfficiency {
    /// Computes the efficiency of a run in a task group; `None` if no two evaluations differ in the
    /// decisions spent in it. Of evaluations with equally many decisions the first one counts for
    /// the area, and all of them count for the decisions.
    pub fn of_run(run: &RunData, group: &str) -> Option<Self> {
        let mut curve = success_curve(run, group);
        let is_solved = |point: &&(f64, f64)| point.1 >= SOLVED_SUCCESS;
        let solved = curve.iter().find(is_solved);
        let decisions = solved.map_or(f64::INFINITY, |(decisions, _)| *decisions);
        let held = curve.iter().rev().take_while(is_solved).last();
        let lasting = held.map_or(f64::INFINITY, |(spent, _)| *spent);
        // evaluations while other groups run add no decisions in this one
        curve.dedup_by_key(|(spent, _)| *spent);
        let whole = curve.last()?.0 - curve[0].0;
        let steps = curve.windows(2);
        let area: f64 =
            steps.map(|pair| (pair[1].0 - pair[0].0) * f64::midpoint(pair[0].1, pair[1].1)).sum();
        (whole > 0.0).then(|| Self {
            area_under_curve: area / whole,
            decisions_to_solve: decisions,
            decisions_to_stay_solved: lasting,
        })
    }
}

/// Returns a point (decisions spent in the group, success in it) for each evaluation of a run that
/// scored the group.
pub(super) fn success_curve(run: &RunData, group: &str) -> Vec<(f64, f64)> {
    let point = |rollouts| {
        let (_, success) = run.mean_group_score_after(rollouts, group, |row| row.success)?;
        Some((spent(run, group, rollouts) as f64, success))
    };
    run.rollouts_before_evaluations().filter_map(point).collect()
}

/// Returns the decisions spent in a group: those of the first `rollouts` rollouts that began in it.
fn spent(run: &RunData, group: &str, rollouts: usize) -> usize {
    let rows = &run.rollouts[..rollouts];
    let before = std::iter::once(0).chain(rows.iter().map(|row| row.decisions));
    let own = rows.iter().zip(before).filter(|(row, _)| row.group == group);
    own.map(|(row, start)| row.decisions - start).sum()
}

/// Returns the table of sample efficiency, with the methods in each group ranked by the area under
/// their learning curve, the largest first; `None` if no run was scored during training.
pub fn sample_efficiency_table(methods: &[MethodRuns], groups: &[String]) -> Option<ReportTable> {
    let caption = format!(
        "How fast methods learn: the area under mean-action success over the decisions spent in a \
         group, decisions until it is at least 0.9 in an evaluation, and until it is so in all that \
         follow, with bootstrap intervals of 95 %, and those of Welch's t for differences. A \
         decision lasts {} control steps. Forward transfer is the difference of the areas divided \
         by 1 less the area of {first}, which should learn every group alone.",
        methods[0].runs[0].experiment.envs.control.action_repeat,
        first = methods[0].name,
    );
    let header = [
        "group",
        "method",
        "area",
        &format!("less that of {}", methods[0].name),
        "forward transfer (Continual World)",
        "outcome",
        "decisions to 0.9: median",
        "90th percentile",
        "seeds that reached it",
        "decisions until it stays at 0.9: median",
        "90th percentile of these",
        "seeds that stayed",
    ];
    let mut table = ReportTable::new(&caption, &header);
    for group in groups {
        let mut rows: Vec<(f64, Vec<String>)> = Vec::new();
        let first = scores(&methods[0], group);
        for (number, method) in methods.iter().enumerate() {
            let [area, decisions, lasting] = scores(method, group);
            if area.min_seed_count() > 0 {
                let is_comparable = number > 0 && first[0].min_seed_count() > 0;
                let compared = is_comparable.then(|| MethodComparison::new(&area, &first[0]));
                let mut row = vec![group.clone(), method_cell(&mut table, method)];
                row.extend(area_cells(&area, compared, &first[0]));
                row.extend(reached(&decisions));
                row.extend(reached(&lasting));
                rows.push((area.pooled_statistic(mean), row));
            }
        }
        rows.sort_by(|one, other| other.0.total_cmp(&one.0));
        table.rows.extend(rows.into_iter().map(|(_, row)| row));
    }
    (!table.rows.is_empty()).then_some(table)
}

/// Returns area, decisions to solve and decisions to stay solved of the runs of a method, each as
/// scores of one group.
fn scores(method: &MethodRuns, group: &str) -> [MethodScores; 3] {
    let runs = method.runs.iter();
    let known: Vec<SampleEfficiency> =
        runs.filter_map(|run| SampleEfficiency::of_run(run, group)).collect();
    let of = |value: fn(&SampleEfficiency) -> f64| {
        MethodScores::new(vec![known.iter().map(value).collect()])
    };
    [
        of(|own| own.area_under_curve),
        of(|own| own.decisions_to_solve),
        of(|own| own.decisions_to_stay_solved),
    ]
}

/// Returns the table cells of areas under learning curves: the mean, its difference from the first
/// method's, forward transfer, and the outcome of the comparison; dashes for the first method
/// itself. Forward transfer is (A - B) / (1 - B) for mean areas A and B, where B is the first
/// method's (Wolczyk et al., "Continual World", NeurIPS 2021, section 3.2).
fn area_cells(
    area: &MethodScores,
    compared: Option<MethodComparison>,
    first: &MethodScores,
) -> [String; 4] {
    let (own, interval) = (area.pooled_statistic(mean), area.bootstrap_interval(mean));
    let room = 1.0 - first.pooled_statistic(mean);
    let difference = |comparison: &MethodComparison| {
        let bounds = bracketed_interval(comparison.welch.map(|test| test.interval), 3);
        format!("{:+.3}{bounds}", comparison.mean_difference)
    };
    let transfer =
        |comparison: &MethodComparison| format!("{:+.2}", comparison.mean_difference / room);
    [
        format!("{own:.3}{}", bracketed_interval(interval, 3)),
        compared.as_ref().map_or_else(empty_cell, difference),
        compared.as_ref().filter(|_| room > 0.0).map_or_else(empty_cell, transfer),
        compared.map_or_else(empty_cell, |compared| compared.outcome().label().to_owned()),
    ]
}

/// Returns the cells of decisions to solve a group: median, 90th percentile, number of seeds that
/// solved it.
fn reached(decisions: &MethodScores) -> [String; 3] {
    // quantiles, not means: a seed that never gets there counts as infinite
    let all = decisions.by_group.concat();
    let reached = all.iter().filter(|one| one.is_finite()).count();
    let (middle, interval) =
        (decisions.pooled_statistic(median), decisions.bootstrap_interval(median));
    let interval = interval.filter(|_| middle.is_finite());
    // an interval of decisions may reach to infinity
    let interval = bracketed_interval(interval, 0).replace("inf", "never");
    [
        format!("{}{interval}", decisions_cell(middle)),
        decisions_cell(quantile(all.clone(), 0.9)),
        format!("{reached} of {}", all.len()),
    ]
}

/// Formats a number of decisions until an event; `never` if it is infinite.
fn decisions_cell(decisions: f64) -> String {
    if decisions.is_finite() { format!("{decisions:.0}") } else { "never".to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::scored_run as run;

    #[test]
    fn decisions_of_other_groups_do_not_count() {
        let seen = run(
            &["b", "a", "b", "b", "a", "a"],
            &[(0, 0.0), (2, 0.5), (4, 0.4), (5, 0.95), (6, 0.8)],
        );
        // 100 decisions from 0 to 0.5, 100 to 0.95, 100 to 0.8
        let efficiency = SampleEfficiency::of_run(&seen, "a").unwrap();
        assert!((efficiency.area_under_curve - (0.25 + 0.725 + 0.875) / 3.0).abs() < 1e-12);
        assert_eq!(efficiency.decisions_to_solve, 200.0);
        assert_eq!(efficiency.decisions_to_stay_solved, f64::INFINITY, "it ends at 0.8");
        assert_eq!(SampleEfficiency::of_run(&seen, "c"), None);
    }

    /// A policy that is trained in another group may get better in this one.
    #[test]
    fn a_group_may_be_solved_while_another_one_runs() {
        let seen = run(&["a", "b", "a"], &[(0, 0.0), (1, 0.5), (2, 0.95), (3, 1.0)]);
        let efficiency = SampleEfficiency::of_run(&seen, "a").unwrap();
        assert_eq!(efficiency.decisions_to_solve, 100.0);
        // 100 decisions from 0 to 0.5, 100 from there to 1
        assert_eq!(efficiency.area_under_curve, 0.5);
    }

    #[test]
    fn what_falls_back_is_solved_for_good_later() {
        let scores = [(0, 0.0), (1, 0.95), (2, 0.8), (3, 0.9), (4, 1.0)];
        let efficiency = SampleEfficiency::of_run(&run(&["a"; 4], &scores), "a").unwrap();
        assert_eq!(
            (efficiency.decisions_to_solve, efficiency.decisions_to_stay_solved),
            (100.0, 300.0)
        );
    }

    #[test]
    fn what_was_never_solved_took_for_ever_and_one_evaluation_makes_no_curve() {
        let unsolved = run(&["a", "a"], &[(0, 0.0), (2, 0.89)]);
        assert_eq!(
            SampleEfficiency::of_run(&unsolved, "a").unwrap().decisions_to_solve,
            f64::INFINITY
        );
        assert_eq!(SampleEfficiency::of_run(&run(&["a"], &[(1, 1.0)]), "a"), None);
    }

    #[test]
    fn the_fastest_method_stands_first() {
        let curves = [("slow", 0.2), ("quick", 0.9)];
        let runs = curves.map(|(name, success)| RunData {
            name: format!("{name}-seed0"),
            ..run(&["a", "a"], &[(0, 0.0), (1, success), (2, 1.0)])
        });
        let methods = MethodRuns::group_by_method(runs.to_vec()).unwrap();
        let table = sample_efficiency_table(&methods, &["a".to_owned()]).unwrap();
        let column = |index: usize| -> Vec<&str> {
            table.rows.iter().map(|row| row[index].as_str()).collect()
        };
        assert_eq!(column(1), ["quick", "slow"]);
        assert_eq!(table.header[3], "less that of slow");
        assert_eq!(column(2), ["0.700", "0.350"]);
        assert_eq!(column(3), ["+0.350", "-"]);
        // 0.35 of the 0.65 that the slow one lacks
        assert_eq!(column(4), ["+0.54", "-"]);
        assert_eq!(column(6), ["100", "200"]);
        assert_eq!(column(9), ["100", "200"]);
        assert!(table.caption.contains("A decision lasts 10 control steps"), "{}", table.caption);
    }
}
