//! Confusion matrices of groups against policies.

use super::matching::policy_after_merges;
use super::svg::escape_xml;
use experiments::RunData;

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
        let policies = run.rollouts.iter().map(|row| row.policy + 1).max();
        let policies = 0..policies.unwrap_or(0);
        let rows = run.scored_groups().into_iter();
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
}
