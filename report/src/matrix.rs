//! Confusion matrices of groups against policies, and against the groups that policies belong to.

use super::format::method_cell;
use super::matching::{own_policy_of_group, policy_after_merges};
use super::method::MethodRuns;
use super::svg::escape_xml;
use super::table::ReportTable;
use super::visits::groups_of_run;
use experiments::RunData;

/// Number of episodes shown in the recognition answers that [`confusion_table`] counts.
const EPISODES_SHOWN: usize = 1;

/// Confusion matrix of task groups against policies: counts `[groups][policies]` and a caption.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PolicyConfusionMatrix {
    /// Sentence that says what the matrix counts.
    pub caption: String,
    /// Names of the matrix's columns: the policies.
    pub columns: Vec<String>,
    /// Name of each task group, and its counts by policy.
    pub rows: Vec<(String, Vec<usize>)>,
}

impl PolicyConfusionMatrix {
    /// Counts the rollouts of each group that each policy was trained on. Rollouts within which the
    /// group changed are left out.
    pub fn of_assignments(run: &RunData) -> Self {
        let mut matrix = Self::new(run, "Rollouts of each group that each policy was trained on.");
        for row in run.rollouts.iter().filter(|row| !row.spans_switch) {
            matrix.count(&row.group, policy_after_merges(&run.rollouts, row.policy), 1);
        }
        matrix
    }

    /// Counts the answers of the recognition test after the stream: the policies that the learner
    /// named when shown the first frames of `episodes` episodes of each group. The last column
    /// counts answers without a policy. `None` if the run has no such answers.
    pub fn of_recognitions(run: &RunData, episodes: usize) -> Option<Self> {
        let caption =
            format!("The policy that was named when so many episodes were shown: {episodes}.");
        let mut matrix = Self::new(run, &caption);
        let none = matrix.columns.len();
        matrix.columns.push("none".to_owned());
        matrix.rows.iter_mut().for_each(|row| row.1.push(0));
        let asked = || run.recognitions.iter().filter(|row| row.episodes_shown == episodes);
        for row in asked() {
            let named = row.policy.map(|policy| policy_after_merges(&run.rollouts, policy));
            matrix.count(&row.group, named.unwrap_or(none), row.count);
        }
        asked().next().is_some().then_some(matrix)
    }

    fn new(run: &RunData, caption: &str) -> Self {
        let policies = 0..run.policy_count();
        let rows = groups_of_run(run).into_iter();
        Self {
            caption: caption.to_owned(),
            rows: rows.map(|group| (group.to_owned(), vec![0; policies.len()])).collect(),
            columns: policies.map(|policy| format!("policy {policy}")).collect(),
        }
    }

    /// Adds `times` to the count of a group in a column. Groups that are not scored and policies
    /// that took no rollout have none.
    fn count(&mut self, group: &str, column: usize, times: usize) {
        let row = self.rows.iter_mut().find(|row| row.0 == group);
        if let Some(cell) = row.and_then(|row| row.1.get_mut(column)) {
            *cell += times;
        }
    }

    /// Returns the confusion matrix as an HTML table whose cells are shaded by their share of the
    /// row.
    pub fn html(&self) -> String {
        let names =
            self.columns.iter().map(|name| format!("<th scope=\"col\">{}</th>", escape_xml(name)));
        let row = |(name, counts): &(String, Vec<usize>)| {
            let all = counts.iter().sum::<usize>().max(1);
            let cell = |count: &usize| {
                let share = 100.0 * *count as f64 / all as f64;
                let tenths = (share / 10.0).round();
                format!("<td class=\"share-{tenths}\" title=\"{share:.1} %\">{count}</td>")
            };
            let cells: String = counts.iter().map(cell).collect();
            format!("<tr><th scope=\"row\">{}</th>{cells}</tr>\n", escape_xml(name))
        };
        format!(
            "<figure class=\"scroll\" tabindex=\"0\">\n<figcaption>{}</figcaption>\n\
             <table class=\"matrix\">\n<thead>\n<tr><td></td>{}</tr>\n</thead>\n<tbody>\n{}</tbody>\n\
             </table>\n</figure>\n",
            escape_xml(&self.caption),
            names.collect::<String>(),
            self.rows.iter().map(row).collect::<String>()
        )
    }
}

/// Returns the table of the groups that each group was taken for: counts over all runs of each
/// method that recognises groups. `None` for a single group, and without such a method.
pub fn confusion_table(methods: &[MethodRuns], groups: &[String]) -> Option<ReportTable> {
    let recognises = |method: &&MethodRuns| {
        let mut runs = method.runs.iter();
        runs.all(|run| run.experiment.learner.recognition_obstacle().is_none())
    };
    let recognising: Vec<_> = methods.iter().filter(recognises).collect();
    if recognising.is_empty() || groups.len() < 2 {
        return None;
    }
    let mut header = vec!["method", "shown", "group"];
    header.extend(groups.iter().map(String::as_str));
    header.extend(["another policy", "no policy"]);
    let caption = "Confusion of groups: rollouts of each group, and answers to the first frame of one \
        episode of it after the stream, by the group whose own policy got the rollout or was named; \
        all runs together. Another policy belongs to none of these groups.";
    let mut table = ReportTable::new(caption, &header);
    for method in recognising {
        let ConfusionCounts { rollouts, answers } = ConfusionCounts::of_runs(&method.runs, groups);
        // runs that were not asked have no answers
        let asked = answers.iter().flatten().any(|&count| count > 0);
        let answers = if asked { answers } else { Vec::new() };
        for (shown, counts) in [("a rollout", rollouts), ("1 episode", answers)] {
            for (group, row) in groups.iter().zip(counts) {
                let mut cells = vec![method_cell(&mut table, method), shown.into(), group.clone()];
                cells.extend(row.iter().map(usize::to_string));
                table.rows.push(cells);
            }
        }
    }
    Some(table)
}

/// Counts `[groups][groups + 2]` of the groups that each group was taken for, another policy and no
/// policy last.
struct ConfusionCounts {
    rollouts: Vec<Vec<usize>>,
    answers: Vec<Vec<usize>>,
}

impl ConfusionCounts {
    fn of_runs(runs: &[RunData], groups: &[String]) -> Self {
        let zeros = || vec![vec![0; groups.len() + 2]; groups.len()];
        let mut counts = Self { rollouts: zeros(), answers: zeros() };
        for run in runs {
            let owned = groups.iter().map(|group| own_policy_of_group(&run.rollouts, group));
            let owned: Vec<Option<usize>> = owned.collect();
            let column = |own: usize, named: Option<usize>| {
                let Some(policy) = named else { return groups.len() + 1 };
                let heir = Some(policy_after_merges(&run.rollouts, policy));
                // the group itself where it shares its policy
                let other = || owned.iter().position(|&policy_of| policy_of == heir);
                if owned[own] == heir { own } else { other().unwrap_or(groups.len()) }
            };
            let index = |name: &str| groups.iter().position(|group| group == name);
            for row in run.rollouts.iter().filter(|row| !row.spans_switch) {
                if let Some(own) = index(&row.group) {
                    counts.rollouts[own][column(own, Some(row.policy))] += 1;
                }
            }
            let shown = run.recognitions.iter();
            for row in shown.filter(|row| row.episodes_shown == EPISODES_SHOWN) {
                if let Some(own) = index(&row.group) {
                    counts.answers[own][column(own, row.policy)] += row.count;
                }
            }
        }
        counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{self, answer, score};
    use experiments::presets::Method;

    fn run() -> RunData {
        let answers = [("a", 4, Some(0), 3), ("b", 4, Some(1), 2), ("b", 4, None, 4)];
        RunData {
            scores: ["a", "b"].map(|group| score(5, group, 0.0)).to_vec(),
            recognitions: answers.iter().map(answer).collect(),
            ..fixtures::run(Method::Covers, &[("a", 0), ("b", 1), ("b*", 0), ("a", 0), ("a", 1)])
        }
    }

    #[test]
    fn rollouts_of_one_group_are_counted() {
        let matrix = PolicyConfusionMatrix::of_assignments(&run());
        assert_eq!(matrix.columns, ["policy 0", "policy 1"]);
        let rows = [("a".to_owned(), vec![2, 1]), ("b".to_owned(), vec![0, 1])];
        assert_eq!(matrix.rows, rows);
        let text = matrix.html();
        assert!(text.contains("share-7") && text.contains(">2</td>"), "{text}");
    }

    #[test]
    fn answers_are_counted_where_somebody_asked() {
        let matrix = PolicyConfusionMatrix::of_recognitions(&run(), 4).unwrap();
        let counts: Vec<&[usize]> = matrix.rows.iter().map(|row| &row.1[..]).collect();
        assert_eq!(counts, [[3, 0, 0], [0, 2, 4]]);
        assert_eq!(PolicyConfusionMatrix::of_recognitions(&run(), 1), None);
    }

    #[test]
    fn groups_are_counted_by_the_groups_of_their_policies() {
        // policy 2 belongs to no group that is scored
        let more = [("b", 1), ("b", 2), ("c", 2), ("c", 2)];
        let served = [[("a", 0), ("b", 1), ("a", 0), ("a", 1)], more].concat();
        let mut own = RunData { rollouts: fixtures::rollouts(&served), ..run() };
        let answers = [("a", 1, Some(1), 3), ("a", 1, None, 1), ("b", 1, Some(2), 4)];
        own.recognitions.extend(answers.iter().map(answer));
        let groups = ["a".to_owned(), "b".to_owned()];
        let methods = MethodRuns::group_by_method(vec![own]).unwrap();
        let table = confusion_table(&methods, &groups).unwrap();
        assert_eq!(table.header[3..], ["a", "b", "another policy", "no policy"]);
        let cells: Vec<&[String]> = table.rows.iter().map(|row| &row[1..]).collect();
        let expected = [
            ["a rollout", "a", "2", "1", "0", "0"],
            ["a rollout", "b", "0", "2", "1", "0"],
            ["1 episode", "a", "0", "3", "0", "1"],
            ["1 episode", "b", "0", "0", "4", "0"],
        ];
        assert_eq!(cells, expected);
        assert_eq!(confusion_table(&methods, &groups[..1]), None);
        let single = fixtures::run(Method::Equi, &[("a", 0), ("b", 0)]);
        let alone = MethodRuns::group_by_method(vec![single]).unwrap();
        assert_eq!(confusion_table(&alone, &groups), None);
    }

    #[test]
    fn a_group_that_shares_its_policy_is_taken_for_itself() {
        let shared = fixtures::run(Method::Covers, &[("a", 0), ("b", 0)]);
        let groups = ["a".to_owned(), "b".to_owned()];
        let counts = ConfusionCounts::of_runs(&[shared], &groups);
        assert_eq!(counts.rollouts, [[1, 0, 0, 0], [0, 1, 0, 0]]);
    }
}
