//! Continual-learning metrics of one run, as docs/results/protocol.md defines them.

use experiments::evaluation::mean;
use experiments::{RolloutRow, RunData, RunStats, ScoreRow};

use super::visits;

/// Reason why a metric is not defined for a run, as a footnote of a table.
pub type UndefinedReason = &'static str;

/// Reason of every metric that needs evaluations, for a run without one.
pub const NOT_EVALUATED: UndefinedReason = "not evaluated yet";
// After the last visit of the stream nothing follows that could make a learner forget.
const ENDS: UndefinedReason = "the stream ends with the group";
const NOT_MET: UndefinedReason = "no rollout of the run began in the group";
const UNSCORED: UndefinedReason =
    "no evaluation at that moment (`evaluation.visit_rounds` makes them)";
const FIRST: UndefinedReason = "there was no training before the group's first visit";
const NO_RETURN: UndefinedReason = "no group came back";
const NO_ROLLOUT: UndefinedReason = "no rollout of one group was assigned";
const NO_EPISODES: UndefinedReason = "no episode ended in training";
const ONE_POLICY: UndefinedReason = "there is one policy for everything";
const NEVER_ALONE: UndefinedReason =
    "a group has no kept rollout to itself, and so no policy of its own";
const UNNAMED: UndefinedReason =
    "`evaluation.csv` does not name the policies that the learner chose";
const UNRECORDED: UndefinedReason = "the run did not record the scores of the groups' own policies";
const UNSEEN: UndefinedReason = "`units.csv`, the table of dormant units, is missing or empty";

/// Metrics of one run for the tables of a report.
#[derive(Clone, Debug, PartialEq)]
pub struct RunMetrics {
    /// Metrics of each task group, in the order in which groups are scored.
    pub groups: Vec<GroupMetrics>,
    /// Share of rollouts without a task switch that went to the policy of their group, in `[0, 1]`
    /// ([`RunStats::correct_assignments`](experiments::RunStats::correct_assignments)).
    pub assignment_accuracy: Result<f64, UndefinedReason>,
    /// Share of rollouts that went to the policy of their group, in `[0, 1]`, among rollouts of
    /// groups that were visited before
    /// ([`RunStats::correct_revisits`](experiments::RunStats::correct_revisits)).
    pub revisit_accuracy: Result<f64, UndefinedReason>,
    /// Success during the whole stream, in `[0, 1]`: the mean over rollouts, weighted by their
    /// decisions, those thrown away before a rollout included.
    pub training_success: Result<f64, UndefinedReason>,
    /// Share of dormant units after the stream over all scored policies together, in `[0, 1]`.
    pub dormant_share: Result<f64, UndefinedReason>,
    /// Number of policies that the learner created.
    pub policy_count: usize,
    /// Number of rollouts of the run, and number of those within which the task group changed.
    pub rollout_and_switch_counts: [usize; 2],
    /// Number of decisions taken in training.
    pub decisions: usize,
}

/// Metrics of one task group in one run.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupMetrics {
    /// Name of the task group.
    pub group: String,
    /// Success rate after the stream of tasks, the mean over the group's variants, in `[0, 1]`.
    pub success: f64,
    /// Success rate at the last step of episodes after the stream of tasks, the mean over the
    /// group's variants, in `[0, 1]`.
    pub success_at_end: f64,
    /// Mean return of episodes after the stream of tasks, over the group's variants, in `[0, 500]`.
    pub reward: f64,
    /// Number of variants for which the learner chose another policy than the group's own after the
    /// stream, and number of all variants
    /// ([`RunStats::own_policies`](experiments::RunStats::own_policies)).
    pub mismatch_and_variant_counts: Result<[usize; 2], UndefinedReason>,
    /// Success rate of the group's own policy after the stream, the mean over episodes, in
    /// `[0, 1]`.
    pub own_success: Result<f64, UndefinedReason>,
    /// Mean return of the group's own policy after the stream, over episodes, in `[0, 500]`.
    pub own_reward: Result<f64, UndefinedReason>,
    /// Highest success rate in earlier evaluations less success rate after the stream, in
    /// `[-1, 1]` (Chaudhry et al., "Riemannian walk for incremental learning", ECCV 2018, equation
    /// 3).
    pub loss_from_best: Result<f64, UndefinedReason>,
    /// Success rate after the group's last visit less success rate after the stream, in `[-1, 1]`
    /// (Wolczyk et al., "Continual World", NeurIPS 2021, section 3.2).
    pub forgetting: Result<f64, UndefinedReason>,
    /// Success rate before a visit less success rate after the group's visit before it, in
    /// `[-1, 1]`, averaged over the group's pauses: above 0 if the group was learnt while others
    /// ran.
    pub backward_transfer: Result<f64, UndefinedReason>,
    /// Forward transfer: success in the last evaluation before anything of the group was seen less
    /// success of the untrained learner, in `[-1, 1]` (Lopez-Paz and Ranzato, "Gradient Episodic
    /// Memory", NeurIPS 2017).
    pub forward_transfer: Result<f64, UndefinedReason>,
}

impl RunMetrics {
    /// Computes the metrics of a run from its tables.
    pub fn of_run(run: &RunData) -> Self {
        let stats = RunStats::from_rollouts(&run.rollouts);
        let is_grouped = run.experiment.learner.may_hold_several_policies();
        // a learner with one policy assigns nothing: 0 or 1 would mislead
        let accuracy = |share: Option<f64>, reason| {
            if is_grouped { share.ok_or(reason) } else { Err(ONE_POLICY) }
        };
        let own = stats.own_policies();
        let groups = run.scored_groups().into_iter();
        Self {
            groups: groups
                .map(|group| GroupMetrics::new(run, group, own.get(group).copied()))
                .collect(),
            assignment_accuracy: accuracy(stats.assignment_accuracy(), NO_ROLLOUT),
            revisit_accuracy: accuracy(stats.revisit_accuracy(), NO_RETURN),
            training_success: training_success(run),
            dormant_share: dormant(run),
            policy_count: stats.created_for_group.len(),
            rollout_and_switch_counts: [stats.rollouts, stats.switch_rollouts],
            decisions: run.rollouts.last().map_or(0, |row| row.decisions),
        }
    }

    /// Returns the mean of a metric over the task groups that have it.
    ///
    /// # Errors
    /// The first group's reason, if no group has the metric.
    pub fn mean_over_groups(
        &self,
        metric: fn(&GroupMetrics) -> Result<f64, UndefinedReason>,
    ) -> Result<f64, UndefinedReason> {
        let metrics: Vec<_> = self.groups.iter().map(metric).collect();
        let known: Vec<f64> = metrics.iter().filter_map(|one| one.ok()).collect();
        match (known.len(), metrics.first()) {
            (0, Some(&Err(reason))) => Err(reason),
            // groups are those of evaluations
            (0, _) => Err(NOT_EVALUATED),
            _ => Ok(mean(&known)),
        }
    }
}

impl GroupMetrics {
    fn new(run: &RunData, group: &str, own: Option<usize>) -> Self {
        let scored = |rollouts, metric| {
            let scored = run.mean_group_score_after(rollouts, group, metric);
            scored.map(|(_, figure)| figure)
        };
        let success = |rollouts| scored(rollouts, |row| row.success);
        let end = run.scores.last().map_or(0, |row| row.rollouts);
        let after = |metric| scored(end, metric).unwrap_or(0.0);
        let last = after(|row| row.success);
        Self {
            group: group.to_owned(),
            success: last,
            success_at_end: after(|row| row.success_at_end),
            reward: after(|row| row.reward),
            mismatch_and_variant_counts: mismatches(run, group, own),
            own_success: of_own(run, group, own, |row| [Some(row.success), row.own_success]),
            own_reward: of_own(run, group, own, |row| [Some(row.reward), row.own_reward]),
            loss_from_best: best_before(run, group, end).map(|best| best - last),
            backward_transfer: backward_transfer(run, group),
            forgetting: end_of_last_visit(run, group)
                .and_then(|rollouts| success(rollouts).ok_or(UNSCORED))
                .map(|then| then - last),
            forward_transfer: before_first_visit(run, group).and_then(|rollouts| {
                let before = success(0).ok_or(UNSCORED)?;
                Ok(success(rollouts).ok_or(UNSCORED)? - before)
            }),
        }
    }
}

/// Returns the scores of a group after the stream, one per variant, each with `true` if the learner
/// chose another policy than the group's own.
fn choices<'a>(
    run: &'a RunData,
    group: &str,
    own: Option<usize>,
) -> Result<Vec<(&'a ScoreRow, bool)>, UndefinedReason> {
    let own = own.ok_or(NEVER_ALONE)?;
    let rows = run.last_scores().filter(|row| row.group == group);
    rows.map(|row| Ok((row, row.policy.ok_or(UNNAMED)? != own))).collect()
}

fn mismatches(
    run: &RunData,
    group: &str,
    own: Option<usize>,
) -> Result<[usize; 2], UndefinedReason> {
    let choices = choices(run, group, own)?;
    let others = choices.iter().filter(|(_, is_other)| *is_other);
    Ok([others.count(), choices.len()])
}

/// Returns the mean over episodes of a metric of the group's own policy. `metric` gives the values
/// of the policy that the learner chose, and of the own one if it was recorded.
fn of_own(
    run: &RunData,
    group: &str,
    own: Option<usize>,
    metric: fn(&ScoreRow) -> [Option<f64>; 2],
) -> Result<f64, UndefinedReason> {
    let (mut sum, mut episodes) = (0.0, 0);
    for (row, is_other) in choices(run, group, own)? {
        // if the learner chose the own policy, no second score is recorded
        let metric = metric(row)[usize::from(is_other)].ok_or(UNRECORDED)?;
        sum += metric * row.episodes as f64;
        episodes += row.episodes;
    }
    Ok(sum / episodes as f64)
}

/// Returns the success during the whole stream, the mean over rollouts weighted by decisions.
fn training_success(run: &RunData) -> Result<f64, UndefinedReason> {
    let before = std::iter::once(0).chain(run.rollouts.iter().map(|row| row.decisions));
    let known = run.rollouts.iter().zip(before).filter_map(|(row, start)| {
        let decisions = (row.decisions - start) as f64;
        row.success.map(|success| (decisions, decisions * success))
    });
    let (decisions, successes) = known.fold((0.0, 0.0), |sum, own| (sum.0 + own.0, sum.1 + own.1));
    if decisions > 0.0 { Ok(successes / decisions) } else { Err(NO_EPISODES) }
}

/// Returns the highest success in a group before the evaluation after `end` rollouts. The group
/// that the stream ends with has none: it may still be learnt then.
fn best_before(run: &RunData, group: &str, end: usize) -> Result<f64, UndefinedReason> {
    end_of_last_visit(run, group)?;
    let earlier = run.rollouts_before_evaluations().filter(|&rollouts| rollouts < end);
    let success = |rollouts| run.mean_group_score_after(rollouts, group, |row| row.success);
    earlier.filter_map(success).map(|(_, success)| success).reduce(f64::max).ok_or(UNSCORED)
}

/// Returns the mean change of success in a group over the pauses between its visits.
fn backward_transfer(run: &RunData, group: &str) -> Result<f64, UndefinedReason> {
    let mut ends = visits::visit_end_rollouts(&run.rollouts, group);
    // two visits may end within one rollout, before the same pause
    ends.dedup();
    let success = |rollouts| {
        let scored = run.mean_group_score_after(rollouts, group, |row| row.success);
        scored.map(|(_, success)| success).ok_or(UNSCORED)
    };
    let shows_group = |row: &&RolloutRow| row.group == group || row.last_group == group;
    let change = |&end: &usize| {
        // after the last visit there is none to come
        let next = end + run.rollouts[end..].iter().position(|row| shows_group(&row))?;
        // no pause: the next visit begins within the rollout after the one that ended this one
        (next > end).then(|| {
            // where the next visit begins within a rollout, the evaluation before that one counts
            let times = run.rollouts_before_evaluations();
            let last = times.filter(|time| (end + 1..=next).contains(time)).max();
            Ok(success(last.ok_or(UNSCORED)?)? - success(end)?)
        })
    };
    let changes: Vec<Result<f64, UndefinedReason>> = ends.iter().filter_map(change).collect();
    let known: Vec<f64> = changes.iter().filter_map(|own| own.ok()).collect();
    match (known.len(), changes.first()) {
        (0, Some(&Err(reason))) => Err(reason),
        (0, _) => Err(NO_RETURN),
        _ => Ok(mean(&known)),
    }
}

/// Returns the share of dormant network units in the last evaluation.
fn dormant(run: &RunData) -> Result<f64, UndefinedReason> {
    let last = run.dormant_units.last().ok_or(UNSEEN)?.rollouts;
    let rows = run.dormant_units.iter().filter(|row| row.rollouts == last);
    let [dormant, units] = rows.fold([0, 0], |[dormant, units], row| {
        [dormant + row.dormant_count, units + row.unit_count]
    });
    Ok(dormant as f64 / units as f64)
}

/// Returns the number of rollouts until a task group's last visit was over.
fn end_of_last_visit(run: &RunData, group: &str) -> Result<usize, UndefinedReason> {
    match visits::visit_end_rollouts(&run.rollouts, group).last() {
        None => Err(NOT_MET),
        Some(&end) if end == run.rollouts.len() => Err(ENDS),
        Some(&end) => Ok(end),
    }
}

/// Returns the number of rollouts until the last evaluation before any task of the group was seen.
fn before_first_visit(run: &RunData, group: &str) -> Result<usize, UndefinedReason> {
    let mut rows = run.rollouts.iter();
    let first = rows.position(|row| row.group == group || row.last_group == group);
    match first {
        None => Err(NOT_MET),
        Some(0) => Err(FIRST),
        Some(first) => {
            let evaluations = run.scores.iter().map(|row| row.rollouts);
            let last = evaluations.filter(|&rollouts| rollouts <= first).max();
            // the evaluation before the stream is the baseline, and cannot be compared with itself
            last.filter(|&rollouts| rollouts > 0).ok_or(UNSCORED)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{self, run};
    use experiments::DormantUnitsRow;
    use experiments::presets::{Budget, Method};

    /// Adds scores of groups `a` and `b` after a number of rollouts, two variants each.
    fn score(run: &mut RunData, rollouts: usize, a: f64, b: f64) {
        for (group, success) in [("a", a), ("b", b)] {
            for (element, shift) in [("identity", 0.05), ("flip x", -0.05)] {
                run.scores.push(ScoreRow {
                    element: element.to_owned(),
                    success: success + shift,
                    reward: 100.0 * success,
                    ..fixtures::score(rollouts, group, success)
                });
            }
        }
    }

    fn near(metric: Result<f64, UndefinedReason>, expected: f64) -> bool {
        metric.is_ok_and(|metric| (metric - expected).abs() < 1e-12)
    }

    #[test]
    fn forgetting_and_transfer_compare_the_right_moments() {
        let stream = [("a", 0), ("a", 0), ("b", 1), ("b", 1), ("a", 0), ("b", 1)];
        let mut run = run(Method::Covers, &stream);
        for (rollouts, a, b) in
            [(0, 0.1, 0.05), (2, 0.6, 0.2), (4, 0.5, 0.7), (5, 0.9, 0.65), (6, 0.7, 0.8)]
        {
            score(&mut run, rollouts, a, b);
        }
        let metrics = RunMetrics::of_run(&run);
        let [a, b] = &metrics.groups[..] else { panic!() };
        assert!(near(Ok(a.success), 0.7) && near(Ok(b.reward), 80.0));
        // a left for the last time after 5 rollouts; b is there at the end
        assert!(near(a.forgetting, 0.2), "{a:?}");
        assert_eq!(b.forgetting, Err(ENDS));
        // b came first after 2 rollouts; nothing came before a
        assert!(near(b.forward_transfer, 0.15), "{b:?}");
        assert_eq!(a.forward_transfer, Err(FIRST));
        assert!(near(metrics.mean_over_groups(|group| group.forgetting), 0.2));
        // the best of a was 0.9, after 5 rollouts
        assert!(near(a.loss_from_best, 0.2), "{a:?}");
        assert_eq!(b.loss_from_best, Err(ENDS));
        // a paused from 2 to 4, b from 4 to 5
        assert!(near(a.backward_transfer, -0.1) && near(b.backward_transfer, -0.05));
        assert_eq!(metrics.training_success, Err(NO_EPISODES));
        // the third rollout took 300 decisions, the others 100
        for (row, success) in run.rollouts.iter_mut().zip([0.0, 0.5, 1.0]) {
            row.success = Some(success);
        }
        run.rollouts[2..].iter_mut().for_each(|row| row.decisions += 200);
        assert!(near(RunMetrics::of_run(&run).training_success, 0.7));
        assert_eq!((metrics.assignment_accuracy, metrics.revisit_accuracy), (Ok(1.0), Ok(1.0)));
        assert_eq!((metrics.policy_count, metrics.rollout_and_switch_counts), (2, [6, 0]));
    }

    /// Group `a` pauses three times: from 1 to 3 rollouts, from 4 to 6, where a rollout of two groups
    /// brings it back, and from 8 to 9, where nothing was scored.
    #[test]
    fn pauses_end_with_the_last_evaluation_before_the_next_visit() {
        let stream = ["a", "b", "b", "a", "b", "b", "b*", "a", "b", "a"].map(|group| (group, 0));
        let mut run = run(Method::Covers, &stream);
        for (rollouts, a) in [(0, 0.0), (1, 0.4), (3, 0.3), (4, 0.8), (6, 0.5), (8, 0.9)] {
            score(&mut run, rollouts, a, 0.0);
        }
        // -0.1 and -0.3
        assert!(near(RunMetrics::of_run(&run).groups[0].backward_transfer, -0.2));
        run.scores.retain(|row| row.rollouts == 0 || row.rollouts == 8);
        assert_eq!(RunMetrics::of_run(&run).groups[0].backward_transfer, Err(UNSCORED));
    }

    #[test]
    fn what_a_straddling_rollout_saw_of_a_group_comes_not_before_it() {
        let mut run = run(Method::Covers, &[("a", 0), ("a*", 0), ("b", 1), ("b", 1), ("a", 1)]);
        for (rollouts, b) in [(0, 0.0), (1, 0.1), (2, 0.4), (5, 0.8)] {
            score(&mut run, rollouts, 0.5, b);
        }
        let metrics = RunMetrics::of_run(&run);
        // the second rollout contains steps of b already
        assert!(near(metrics.groups[1].forward_transfer, 0.1), "{metrics:?}");
        assert_eq!(metrics.rollout_and_switch_counts, [5, 1]);
        assert_eq!((metrics.assignment_accuracy, metrics.revisit_accuracy), (Ok(0.75), Ok(0.0)));
    }

    #[test]
    fn an_heir_is_right_where_its_policy_was() {
        let mut run = run(Method::Covers, &[("a", 0), ("b", 1), ("a", 2), ("a", 2)]);
        assert_eq!(RunMetrics::of_run(&run).revisit_accuracy, Ok(0.0));
        run.rollouts[2].merged_into = vec![Some(2), None, None];
        assert_eq!(RunMetrics::of_run(&run).revisit_accuracy, Ok(0.5));
    }

    #[test]
    fn the_own_policy_counts_where_another_one_played() {
        let mut run = run(Method::Covers, &[("a", 0), ("b", 1)]);
        score(&mut run, 2, 0.5, 0.8);
        assert_eq!(RunMetrics::of_run(&run).groups[0].mismatch_and_variant_counts, Err(UNNAMED));
        let chosen = [1, 0, 1, 1];
        for (row, policy) in run.scores.iter_mut().zip(chosen) {
            row.policy = Some(policy);
        }
        let metrics = RunMetrics::of_run(&run);
        let [a, b] = &metrics.groups[..] else { panic!() };
        assert_eq!(
            (a.mismatch_and_variant_counts, b.mismatch_and_variant_counts),
            (Ok([1, 2]), Ok([0, 2]))
        );
        assert_eq!(a.own_success, Err(UNRECORDED));
        assert!(near(b.own_success, 0.8) && near(b.own_reward, 80.0));
        run.scores[0].own_success = Some(0.95);
        run.scores[0].own_reward = Some(450.0);
        let recorded = RunMetrics::of_run(&run);
        let recorded_a = &recorded.groups[0];
        assert!(near(recorded_a.own_success, f64::midpoint(0.95, 0.45)), "{recorded_a:?}");
        assert!(near(recorded_a.own_reward, f64::midpoint(450.0, 50.0)), "{recorded_a:?}");
        assert!(near(Ok(recorded_a.success), 0.5));
        run.rollouts[0].group = "c".to_owned();
        assert_eq!(
            RunMetrics::of_run(&run).groups[0].mismatch_and_variant_counts,
            Err(NEVER_ALONE)
        );
    }

    #[test]
    fn dormant_units_are_those_of_the_last_evaluation_over_all_policies() {
        let mut run = run(Method::Covers, &[("a", 0), ("b", 1)]);
        assert_eq!(RunMetrics::of_run(&run).dormant_share, Err(UNSEEN));
        let row = |(rollouts, policy, dormant)| DormantUnitsRow {
            rollouts,
            decisions: 500 * rollouts,
            policy,
            unit_count: 40,
            dormant_count: dormant,
        };
        run.dormant_units = [(0, 0, 39), (2, 0, 1), (2, 1, 3)].map(row).to_vec();
        assert!(near(RunMetrics::of_run(&run).dormant_share, 0.05));
    }

    #[test]
    fn undefined_figures_say_why() {
        let mut run = run(Method::Equi, &[("a", 0), ("b", 0)]);
        score(&mut run, 2, 0.5, 0.5);
        let metrics = RunMetrics::of_run(&run);
        assert_eq!(metrics.assignment_accuracy, Err(ONE_POLICY));
        assert_eq!(metrics.groups[0].forgetting, Err(UNSCORED));
        assert_eq!(metrics.groups[1].forward_transfer, Err(UNSCORED));
        run.rollouts.truncate(1);
        assert_eq!(RunMetrics::of_run(&run).groups[1].forgetting, Err(NOT_MET));
        run.experiment = Budget::Smoke.preset_experiment(Method::Covers);
        assert_eq!(RunMetrics::of_run(&run).revisit_accuracy, Err(NO_RETURN));
    }
}
