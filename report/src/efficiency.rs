//! How fast methods learn: areas under learning curves, and decisions until a group is solved.

use super::cells::{brackets, title};
use super::comparison::Comparison;
use super::method::MethodRuns;
use super::statistics::{Scores, median, quantile};
use super::table::Table;
use experiments::RunData;
use experiments::evaluation::mean;

/// Success from which a group counts as solved.
pub const SOLVED: f64 = 0.9;

/// How fast one run learnt one group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Efficiency {
    /// Area under the success over the decisions spent in the group, as a share of the whole, in
    /// `[0, 1]`.
    pub area: f64,
    /// Decisions spent in the group before the first evaluation with a success of at least
    /// [`SOLVED`]; infinite where none was.
    pub decisions: f64,
    /// Decisions spent in the group before the first evaluation from which on every one has such a
    /// success; infinite where the last one has not.
    pub lasting: f64,
}

impl Efficiency {
    /// That of a group; none where no two evaluations differ in the decisions spent in it. Of those
    /// that do not differ the first one counts for the area, and all of them for the decisions.
    pub fn of(run: &RunData, group: &str) -> Option<Self> {
        let mut curve = curve(run, group);
        let solved = curve.iter().find(|(_, success)| *success >= SOLVED);
        let decisions = solved.map_or(f64::INFINITY, |(decisions, _)| *decisions);
        let held = curve.iter().rev();
        let held = held.take_while(|(_, success)| *success >= SOLVED);
        let lasting = held.last().map_or(f64::INFINITY, |(decisions, _)| *decisions);
        // while other groups run, nothing is spent
        curve.dedup_by_key(|(spent, _)| *spent);
        let whole = curve.last()?.0 - curve[0].0;
        let steps = curve.windows(2);
        let area: f64 =
            steps.map(|pair| (pair[1].0 - pair[0].0) * f64::midpoint(pair[0].1, pair[1].1)).sum();
        (whole > 0.0).then(|| Self { area: area / whole, decisions, lasting })
    }
}

/// Decisions spent in the group and success in it, of each evaluation.
pub(super) fn curve(run: &RunData, group: &str) -> Vec<(f64, f64)> {
    let point = |rollouts| {
        let (_, success) = run.scored(rollouts, group, |row| row.success)?;
        Some((spent(run, group, rollouts) as f64, success))
    };
    run.evaluated().filter_map(point).collect()
}

/// Decisions of the first `rollouts` rollouts that began in the group.
fn spent(run: &RunData, group: &str, rollouts: usize) -> usize {
    let rows = &run.rollouts[..rollouts];
    let before = std::iter::once(0).chain(rows.iter().map(|row| row.decisions));
    let own = rows.iter().zip(before).filter(|(row, _)| row.group == group);
    own.map(|(row, before)| row.decisions - before).sum()
}

/// The methods of each group, the fastest first; none where no run was scored while it learnt.
pub fn table(methods: &[MethodRuns], groups: &[String]) -> Option<Table> {
    let caption = "How fast methods learn: the area under mean-action success over the decisions \
        spent in a group, decisions until it is at least 0.9 in an evaluation, and until it is so in \
        all that follow, with bootstrap intervals of 95 %.";
    let header = [
        "group",
        "method",
        "area",
        &format!("less that of {}", methods[0].name),
        "by the interval",
        "decisions to 0.9: median",
        "90th percentile",
        "seeds that reached it",
        "decisions until it stays at 0.9: median",
        "90th percentile of these",
        "seeds that stayed",
    ];
    let mut table = Table::new(caption, &header);
    for group in groups {
        let mut rows: Vec<(f64, Vec<String>)> = Vec::new();
        let first = scores(&methods[0], group);
        for method in methods {
            let [area, decisions, lasting] = scores(method, group);
            if area.seeds() > 0 {
                let compared = Comparison::new(&area, &first[0]);
                let mut row = vec![group.clone(), title(&mut table, method)];
                row.extend(shares(&area, compared));
                row.extend(reached(&decisions));
                row.extend(reached(&lasting));
                rows.push((area.of(mean), row));
            }
        }
        rows.sort_by(|one, other| other.0.total_cmp(&one.0));
        table.rows.extend(rows.into_iter().map(|(_, row)| row));
    }
    (!table.rows.is_empty()).then_some(table)
}

/// Areas, decisions and lasting ones of the runs of a method, as scores of one group.
fn scores(method: &MethodRuns, group: &str) -> [Scores; 3] {
    let runs = method.runs.iter();
    let known: Vec<Efficiency> = runs.filter_map(|run| Efficiency::of(run, group)).collect();
    let of = |figure: fn(&Efficiency) -> f64| Scores(vec![known.iter().map(figure).collect()]);
    [of(|own| own.area), of(|own| own.decisions), of(|own| own.lasting)]
}

/// Cells of areas: the mean, and what it is more than another method's.
fn shares(area: &Scores, compared: Comparison) -> [String; 3] {
    let (mean, interval) = (area.of(mean), area.interval(mean));
    let (difference, apart) = (compared.difference, compared.interval);
    [
        format!("{mean:.3}{}", brackets(interval, 3)),
        format!("{difference:+.3}{}", brackets(apart, 3)),
        compared.verdict().word().to_owned(),
    ]
}

/// Cells of decisions: median, 90th percentile, and how many seeds have a number.
fn reached(decisions: &Scores) -> [String; 3] {
    let all = decisions.0.concat();
    let reached = all.iter().filter(|decisions| decisions.is_finite()).count();
    let (middle, interval) = (decisions.of(median), decisions.interval(median));
    [
        format!("{middle:.0}{}", brackets(interval, 0)),
        format!("{:.0}", quantile(all.clone(), 0.9)),
        format!("{reached} of {}", all.len()),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use experiments::presets::{Budget, Method};
    use experiments::{RolloutRow, ScoreRow};

    /// Rollouts of 100 decisions of these groups, and the success in `a` after some of them.
    fn run(groups: &[&str], scores: &[(usize, f64)]) -> RunData {
        let rollouts = groups.iter().zip(1..).map(|(group, turn)| RolloutRow {
            decisions: 100 * turn,
            group: (*group).to_owned(),
            last_group: (*group).to_owned(),
            ..RolloutRow::default()
        });
        let row = |&(rollouts, success): &(usize, f64)| ScoreRow {
            rollouts,
            decisions: 100 * rollouts,
            group: "a".to_owned(),
            element: "identity".to_owned(),
            seen: true,
            episodes: 10,
            success,
            success_at_end: success,
            ..ScoreRow::default()
        };
        RunData {
            rollouts: rollouts.collect(),
            scores: scores.iter().map(row).collect(),
            ..RunData::empty("covers-seed0", Budget::Smoke.experiment(Method::Covers))
        }
    }

    #[test]
    fn decisions_of_other_groups_do_not_count() {
        let run = run(
            &["b", "a", "b", "b", "a", "a"],
            &[(0, 0.0), (2, 0.5), (4, 0.4), (5, 0.95), (6, 0.8)],
        );
        // 100 decisions from 0 to 0.5, 100 to 0.95, 100 to 0.8
        let efficiency = Efficiency::of(&run, "a").unwrap();
        assert!((efficiency.area - (0.25 + 0.725 + 0.875) / 3.0).abs() < 1e-12);
        assert_eq!(efficiency.decisions, 200.0);
        assert_eq!(efficiency.lasting, f64::INFINITY, "it ends at 0.8");
        assert_eq!(Efficiency::of(&run, "c"), None);
    }

    /// As where a policy learns in another group, too.
    #[test]
    fn a_group_may_be_solved_while_another_one_runs() {
        let run = run(&["a", "b", "a"], &[(0, 0.0), (1, 0.5), (2, 0.95), (3, 1.0)]);
        let efficiency = Efficiency::of(&run, "a").unwrap();
        assert_eq!(efficiency.decisions, 100.0);
        // 100 decisions from 0 to 0.5, 100 from there to 1
        assert_eq!(efficiency.area, 0.5);
    }

    #[test]
    fn what_falls_back_is_solved_for_good_later() {
        let scores = [(0, 0.0), (1, 0.95), (2, 0.8), (3, 0.9), (4, 1.0)];
        let efficiency = Efficiency::of(&run(&["a"; 4], &scores), "a").unwrap();
        assert_eq!((efficiency.decisions, efficiency.lasting), (100.0, 300.0));
    }

    #[test]
    fn what_was_never_solved_took_for_ever_and_one_evaluation_makes_no_curve() {
        let unsolved = run(&["a", "a"], &[(0, 0.0), (2, 0.89)]);
        assert_eq!(Efficiency::of(&unsolved, "a").unwrap().decisions, f64::INFINITY);
        assert_eq!(Efficiency::of(&run(&["a"], &[(1, 1.0)]), "a"), None);
    }

    #[test]
    fn the_fastest_method_stands_first() {
        let curves = [("slow", 0.2), ("quick", 0.9)];
        let runs = curves.map(|(name, success)| RunData {
            name: format!("{name}-seed0"),
            ..run(&["a", "a"], &[(0, 0.0), (1, success), (2, 1.0)])
        });
        let methods = MethodRuns::sort(runs.to_vec()).unwrap();
        let table = table(&methods, &["a".to_owned()]).unwrap();
        let column = |index: usize| -> Vec<&str> {
            table.rows.iter().map(|row| row[index].as_str()).collect()
        };
        assert_eq!(column(1), ["quick", "slow"]);
        assert_eq!(table.header[3], "less that of slow");
        assert_eq!(column(2), ["0.700", "0.350"]);
        assert_eq!(column(3), ["+0.350", "+0.000"]);
        assert_eq!(column(5), ["100", "200"]);
        assert_eq!(column(8), ["100", "200"]);
    }
}
