//! Table of recognition: the share of groups that learners recognise from a few first frames.

use experiments::evaluation::{RECOGNITION_EPISODE_COUNTS, mean};

use super::format::{mean_cell, method_cell};
use super::matching::{own_policy_of_group, policy_after_merges};
use super::method::MethodRuns;
use super::metrics::UndefinedReason;
use super::table::ReportTable;
use experiments::RunData;

const UNASKED: UndefinedReason = "the run did not ask (`evaluation.looks` makes it)";

/// Returns the table of recognition tests: the share of right answers for each number of episodes
/// shown; `None` if no run has answers.
pub fn recognition_table(methods: &[MethodRuns], groups: &[String]) -> Option<ReportTable> {
    let mut runs = methods.iter().flat_map(|method| &method.runs);
    if runs.all(|run| run.recognitions.is_empty()) {
        return None;
    }
    let mut header = vec!["method", "episodes shown"];
    header.extend(groups.iter().map(String::as_str));
    header.extend(["average", "named none"]);
    let caption = "Recognition after the stream: how often the policy that belongs to a group was \
        named from first frames of episodes of it, and how often no policy; means over variants and \
        seeds. A group that no policy belongs to has no right answers. Methods with one policy for \
        everything and those that are told the group are left out.";
    let mut table = ReportTable::new(caption, &header);
    let can_be_asked = |run: &RunData| run.experiment.learner.recognition_obstacle().is_none();
    for method in methods.iter().filter(|method| method.runs.iter().any(can_be_asked)) {
        for episodes in RECOGNITION_EPISODE_COUNTS {
            let mut row = vec![method_cell(&mut table, method), episodes.to_string()];
            for group in groups {
                let own = std::slice::from_ref(group);
                row.push(mean_cell(
                    &mut table,
                    &per_run(method, |run| accuracy(run, own, episodes)),
                ));
            }
            row.push(mean_cell(
                &mut table,
                &per_run(method, |run| accuracy(run, groups, episodes)),
            ));
            row.push(mean_cell(&mut table, &per_run(method, |run| unnamed(run, groups, episodes))));
            table.rows.push(row);
        }
    }
    Some(table)
}

/// Returns a metric of recognition for each run of a method.
fn per_run(
    method: &MethodRuns,
    metric: impl Fn(&RunData) -> Result<f64, UndefinedReason>,
) -> Vec<Result<f64, UndefinedReason>> {
    method.runs.iter().map(metric).collect()
}

/// Returns the share of right answers in the recognition test, the mean over groups.
fn accuracy(run: &RunData, groups: &[String], episodes: usize) -> Result<f64, UndefinedReason> {
    // "none" is no right answer, even for a group that no policy belongs to
    let is_right = |named: Option<usize>, own| named.is_some() && named == own;
    share(run, groups, episodes, is_right)
}

/// Returns the share of answers in the recognition test that named no policy, the mean over groups.
fn unnamed(run: &RunData, groups: &[String], episodes: usize) -> Result<f64, UndefinedReason> {
    share(run, groups, episodes, |named, _| named.is_none())
}

/// Returns the share of recognition answers for which `counts` is `true`, the mean over groups. The
/// arguments of `counts` are the policy that was named and the one that belongs to the group.
fn share(
    run: &RunData,
    groups: &[String],
    episodes: usize,
    counts: fn(Option<usize>, Option<usize>) -> bool,
) -> Result<f64, UndefinedReason> {
    let share_of = |group: &String| {
        let own = own_policy_of_group(&run.rollouts, group);
        let answers = run.recognitions.iter();
        let answers = answers.filter(|row| row.group == *group && row.episodes_shown == episodes);
        let [all, counted] = answers.fold([0, 0], |[all, counted], row| {
            let named = row.policy.map(|policy| policy_after_merges(&run.rollouts, policy));
            let times = usize::from(counts(named, own)) * row.count;
            [all + row.count, counted + times]
        });
        (all > 0).then(|| counted as f64 / all as f64)
    };
    let shares: Option<Vec<f64>> = groups.iter().map(share_of).collect();
    shares.map(|shares| mean(&shares)).ok_or(UNASKED)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{self, answer};
    use experiments::RolloutRow;
    use experiments::presets::Method;

    /// Returns a run in which policy 0 belongs to group `a` and 1 to `b`, with these answers.
    fn run(method: Method, answers: &[(&str, usize, Option<usize>, usize)]) -> RunData {
        RunData {
            recognitions: answers.iter().map(answer).collect(),
            ..fixtures::run(method, &[("a", 0), ("b", 1)])
        }
    }

    fn rows(run: RunData) -> Vec<Vec<String>> {
        let methods = MethodRuns::group_by_method(vec![run]).unwrap();
        let groups = ["a".to_owned(), "b".to_owned()];
        recognition_table(&methods, &groups).unwrap().rows
    }

    #[test]
    fn answers_are_right_that_name_the_policy_of_the_group() {
        let rows = rows(run(
            Method::Covers,
            &[
                ("a", 1, Some(0), 3),
                ("a", 1, Some(1), 1),
                ("b", 1, Some(0), 4),
                ("b", 1, Some(1), 4),
                ("a", 4, Some(0), 2),
                ("b", 4, None, 2),
            ],
        ));
        let cells = |row: usize| rows[row][1..].to_vec();
        assert_eq!(cells(0), ["1", "0.750", "0.500", "0.625", "0.000"]);
        assert_eq!(cells(1), ["4", "1.000", "0.000", "0.500", "0.500"]);
        assert_eq!(cells(2), ["20", "- (1)", "- (1)", "- (1)", "- (1)"]);
    }

    #[test]
    fn a_group_that_shares_its_policy_has_no_right_answers() {
        let answers = [("a", 1, Some(0), 4), ("b", 1, Some(0), 4)];
        let mut lumping = run(Method::Covers, &answers);
        lumping.rollouts[1].policy = 0;
        lumping.rollouts.push(RolloutRow { decisions: 300, ..lumping.rollouts[0].clone() });
        assert_eq!(rows(lumping)[0][2..5], ["1.000", "0.000", "0.500"]);
    }

    /// Policy 2 went on for policy 0, which served group `a` for longer.
    #[test]
    fn the_answer_of_an_heir_is_right_where_its_policy_was() {
        let mut merged = run(Method::Covers, &[("a", 1, Some(2), 4), ("b", 1, Some(1), 4)]);
        let first = merged.rollouts[0].clone();
        merged.rollouts.push(RolloutRow { decisions: 300, ..first.clone() });
        merged.rollouts.push(RolloutRow { decisions: 400, policy: 2, ..first });
        assert_eq!(rows(merged.clone())[0][2..5], ["0.000", "1.000", "0.500"]);
        merged.rollouts[3].merged_into = vec![Some(2), None, None];
        assert_eq!(rows(merged)[0][2..5], ["1.000", "1.000", "1.000"]);
    }

    #[test]
    fn methods_that_cannot_be_asked_are_left_out_and_others_say_why() {
        for (method, can_be_asked) in
            [(Method::Cnn, false), (Method::CoversGt, false), (Method::Covers, true)]
        {
            let groups = ["a".to_owned()];
            let silent = run(method, &[]);
            let alone = MethodRuns::group_by_method(vec![silent.clone()]).unwrap();
            assert!(recognition_table(&alone, &groups).is_none());
            let asked = run(Method::CoversCnn, &[("a", 1, Some(0), 4)]);
            let both = MethodRuns::group_by_method(vec![silent, asked]).unwrap();
            let table = recognition_table(&both, &groups).unwrap();
            assert_eq!(table.rows.len(), if can_be_asked { 6 } else { 3 });
            assert_eq!(table.rows[table.rows.len() - 3][2], "1.000");
            if can_be_asked {
                assert_eq!(table.rows[0][2..], ["- (1)", "- (1)", "- (1)"]);
                assert!(table.footnotes[0].contains("did not ask"), "{:?}", table.footnotes);
            }
        }
    }
}
