//! Which policy got what: counts of groups against policies.

use super::partners::last_acting;
use super::svg::escaped;
use experiments::RunData;

/// Counts `[groups][policies]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Matrix {
    /// What is counted, a sentence.
    pub caption: String,
    /// Names of the columns.
    pub columns: Vec<String>,
    /// The name and the counts of each row.
    pub rows: Vec<(String, Vec<usize>)>,
}

impl Matrix {
    /// Rollouts of each group that each policy learnt from; those within which the group changed
    /// count for nobody.
    pub fn assigned(run: &RunData) -> Self {
        let mut matrix = Self::new(run, "Rollouts of each group that a policy learnt from.");
        for row in run.rollouts.iter().filter(|row| !row.straddles) {
            matrix.count(&row.group, last_acting(&run.rollouts, row.policy), 1);
        }
        matrix
    }

    /// Answers after the stream to `episodes` first frames of each group; the last column counts
    /// those that named no policy. None where nobody asked.
    pub fn recognised(run: &RunData, episodes: usize) -> Option<Self> {
        let caption =
            format!("The policy that was named when so many episodes were shown: {episodes}.");
        let mut matrix = Self::new(run, &caption);
        let none = matrix.columns.len();
        matrix.columns.push("none".to_owned());
        matrix.rows.iter_mut().for_each(|row| row.1.push(0));
        let asked = || run.recognition.iter().filter(|row| row.episodes == episodes);
        for row in asked() {
            let named = row.policy.map(|policy| last_acting(&run.rollouts, policy));
            matrix.count(&row.group, named.unwrap_or(none), row.times);
        }
        asked().next().is_some().then_some(matrix)
    }

    fn new(run: &RunData, caption: &str) -> Self {
        let policies = run.rollouts.iter().map(|row| row.policy + 1).max();
        let policies = 0..policies.unwrap_or(0);
        let rows = run.groups().into_iter();
        Self {
            caption: caption.to_owned(),
            rows: rows.map(|group| (group.to_owned(), vec![0; policies.len()])).collect(),
            columns: policies.map(|policy| format!("policy {policy}")).collect(),
        }
    }

    /// Adds to a cell; groups that are not scored and policies that never learnt have none.
    fn count(&mut self, group: &str, column: usize, times: usize) {
        let row = self.rows.iter_mut().find(|row| row.0 == group);
        if let Some(cell) = row.and_then(|row| row.1.get_mut(column)) {
            *cell += times;
        }
    }

    /// A table whose cells are the darker the larger their share of the row is.
    pub fn html(&self) -> String {
        let names = self.columns.iter().map(|name| format!("<th>{name}</th>"));
        let row = |(name, counts): &(String, Vec<usize>)| {
            let all = counts.iter().sum::<usize>().max(1);
            let cells = counts.iter().map(|count| {
                let share = 100.0 * *count as f64 / all as f64;
                format!("<td style=\"--share:{share:.0}%\" title=\"{share:.1} %\">{count}</td>")
            });
            let cells: String = cells.collect();
            format!("<tr><th scope=\"row\">{}</th>{cells}</tr>\n", escaped(name))
        };
        format!(
            "<div class=\"wide\"><p class=\"caption\">{}</p>\n<table class=\"matrix\">\n\
             <tr><th></th>{}</tr>\n{}</table></div>\n",
            escaped(&self.caption),
            names.collect::<String>(),
            self.rows.iter().map(row).collect::<String>()
        )
    }
}

#[cfg(test)]
mod tests {
    use symmetry::D2;

    use super::*;
    use experiments::presets::{Budget, Method};
    use experiments::{RecognitionRow, RolloutRow, ScoreRow};

    fn run() -> RunData {
        let rollout = |&(group, policy): &(&str, usize)| RolloutRow {
            group: group.trim_end_matches('*').to_owned(),
            policy,
            straddles: group.ends_with('*'),
            ..RolloutRow::default()
        };
        let rollouts = [("a", 0), ("b", 1), ("b*", 0), ("a", 0), ("a", 1)];
        let score = |group: &str| ScoreRow {
            rollouts: 5,
            decisions: 0,
            group: group.to_owned(),
            element: "identity".to_owned(),
            seen: true,
            episodes: 1,
            success: 0.0,
            ..ScoreRow::default()
        };
        let answer = |(group, policy, times): (&str, Option<usize>, usize)| RecognitionRow {
            group: group.to_owned(),
            element: D2::Identity.to_string(),
            episodes: 4,
            policy,
            times,
        };
        RunData {
            rollouts: rollouts.iter().map(rollout).collect(),
            scores: ["a", "b"].map(score).to_vec(),
            recognition: [("a", Some(0), 3), ("b", Some(1), 2), ("b", None, 4)]
                .map(answer)
                .to_vec(),
            ..RunData::empty("covers-seed0", Budget::Smoke.experiment(Method::Covers))
        }
    }

    #[test]
    fn rollouts_of_one_group_are_counted() {
        let matrix = Matrix::assigned(&run());
        assert_eq!(matrix.columns, ["policy 0", "policy 1"]);
        let rows = [("a".to_owned(), vec![2, 1]), ("b".to_owned(), vec![0, 1])];
        assert_eq!(matrix.rows, rows);
        let text = matrix.html();
        assert!(text.contains("--share:67%") && text.contains(">2</td>"), "{text}");
    }

    #[test]
    fn answers_are_counted_where_somebody_asked() {
        let matrix = Matrix::recognised(&run(), 4).unwrap();
        let counts: Vec<&[usize]> = matrix.rows.iter().map(|row| &row.1[..]).collect();
        assert_eq!(counts, [[3, 0, 0], [0, 2, 4]]);
        assert_eq!(Matrix::recognised(&run(), 1), None);
    }
}
