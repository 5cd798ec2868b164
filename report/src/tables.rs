//! Tables of a report.

use std::collections::HashSet;

use experiments::evaluation::{DORMANCY_THRESHOLD, mean};

use super::comparison::{EQUIVALENCE_MARGIN, MethodComparison};
use super::format::{
    bracketed_interval, empty_cell, mean_cell, method_cell, p_value_cell, score_text,
    unfinished_remark, with_footnotes,
};
use super::method::MethodRuns;
use super::metrics::{GroupMetrics, NOT_EVALUATED, RunMetrics, UndefinedReason};
use super::statistics::interquartile_mean;
use super::table::ReportTable;
use super::{efficiency, matrix, paper, per_visit, recognition};
use experiments::RunData;

const NOT_ONE_TO_ONE: &str = "the paper's scenes, rewards and camera are Meta-World's and ours were \
    built for exact symmetry, so success rates do not compare one to one";

/// Names of the tables that not every report has.
pub const OPTIONAL_REPORT_TABLES: [&str; 6] =
    ["comparisons", "visits", "efficiency", "variants", "recognition", "confusion"];

/// Returns all tables of a report on these methods, each with a name, for the groups that every run
/// was scored on. The first method is compared with the others.
pub fn report_tables(methods: &[MethodRuns]) -> Vec<(&'static str, ReportTable)> {
    let groups = common_groups(methods);
    let mut tables =
        vec![("results", results(methods, &groups)), ("seeds", over_seeds(methods, &groups))];
    if methods.len() > 1 {
        tables.push(("comparisons", comparisons(methods, &groups)));
    }
    if let Some(table) = per_visit::success_per_visit_table(methods, &groups) {
        tables.push(("visits", table));
    }
    if let Some(table) = efficiency::sample_efficiency_table(methods, &groups) {
        tables.push(("efficiency", table));
    }
    if !groups.is_empty() {
        tables.push(("variants", variants(methods, &groups)));
    }
    if let Some(table) = recognition::recognition_table(methods, &groups) {
        tables.push(("recognition", table));
    }
    if let Some(table) = matrix::confusion_table(methods, &groups) {
        tables.push(("confusion", table));
    }
    tables.push(("runs", runs(methods, &groups)));
    tables
}

/// Returns the groups that all runs with an evaluation were scored on, in the order of the first
/// such run.
pub fn common_groups(methods: &[MethodRuns]) -> Vec<String> {
    let runs = methods.iter().flat_map(|method| &method.metrics);
    let mut runs = runs.filter(|run| !run.groups.is_empty());
    let Some(first) = runs.next() else {
        return Vec::new();
    };
    let mut groups: Vec<String> = first.groups.iter().map(|group| group.group.clone()).collect();
    for run in runs {
        groups.retain(|group| run.groups.iter().any(|own| own.group == *group));
    }
    groups
}

/// Returns the table of success and reward in the paper's form, with the paper's numbers below
/// those of the same method.
fn results(methods: &[MethodRuns], groups: &[String]) -> ReportTable {
    let mut header = vec!["method"];
    header.extend(groups.iter().map(String::as_str));
    header.extend(["average", "average with own policies", "mismatched variants"]);
    let caption = "Success and reward (of 500) after the stream: means over seeds and variants, with \
        95 % intervals of success for two seeds or more, unless all draws of the bootstrap are \
        equal. A variant is played by the policy that the method recognises; it \
        is mismatched where that is not the group's own, which served the group in most rollouts.";
    let mut table = ReportTable::new(caption, &header);
    // two methods may stand for one of the paper's
    let mut printed = HashSet::new();
    for method in methods {
        let of = |chosen: &[String]| {
            let success = method.success(chosen);
            let reward = method.scores(chosen, |group| group.reward).pooled_statistic(mean);
            let interval = bracketed_interval(success.bootstrap_interval(mean), 2);
            let mean_success = success.pooled_statistic(mean);
            score_text(mean_success, format!("{mean_success:.3}{interval} / {reward:.0}"))
        };
        let mut row = vec![method_cell(&mut table, method)];
        row.extend(groups.chunks(1).map(of));
        row.push(of(groups));
        row.extend(own_policies(&mut table, method, groups));
        table.rows.push(row);
        if let Some(paper) = method.preset_match.method.and_then(paper::paper_row)
            && printed.insert(paper.method.name())
        {
            let mark = table.add_footnote(NOT_ONE_TO_ONE);
            let cell = |(success, reward): (f64, f64)| format!("{success:.2} / {reward:.0}");
            let paper_cell = |group: &String| {
                paper.group_success_and_reward(group).map_or_else(empty_cell, cell)
            };
            let mut paper_row = vec![format!("{} in the paper {mark}", paper.method.name())];
            paper_row.extend(groups.iter().map(paper_cell));
            paper_row.push(cell(paper.average_success_and_reward));
            paper_row.extend([empty_cell(), empty_cell()]);
            table.rows.push(paper_row);
        }
    }
    table
}

/// Returns the cells of success and reward with the groups' own policies, and of the number of
/// variants that another policy played. A score that any run lacks becomes a footnote.
fn own_policies(table: &mut ReportTable, method: &MethodRuns, groups: &[String]) -> [String; 2] {
    let metrics = method.metrics.iter().flat_map(|metrics| &metrics.groups);
    let of_groups: Vec<&GroupMetrics> =
        metrics.filter(|group| groups.contains(&group.group)).collect();
    let scores = of_groups
        .iter()
        .map(|group| Ok((group.own_success?, group.own_reward?)))
        .collect::<Result<Vec<(f64, f64)>, UndefinedReason>>();
    let score = scores.map(|scores| {
        let (success, reward) = scores.into_iter().unzip::<_, _, Vec<f64>, Vec<f64>>();
        let mean_success = mean(&success);
        score_text(mean_success, format!("{mean_success:.3} / {:.0}", mean(&reward)))
    });
    let counts = of_groups
        .iter()
        .map(|group| group.mismatch_and_variant_counts)
        .collect::<Result<Vec<_>, _>>();
    let count = counts.map(|counts| {
        let [others, all] =
            counts.into_iter().fold([0, 0], |sum, group| [sum[0] + group[0], sum[1] + group[1]]);
        if all == 0 { NOT_EVALUATED.to_owned() } else { format!("{others} of {all}") }
    });
    let mut cell = |text: Result<String, UndefinedReason>| {
        text.unwrap_or_else(|reason| format!("- {}", table.add_footnote(reason)))
    };
    [cell(score), cell(count)]
}

/// Names of the columns of the table of statistics over seeds.
const OVER_SEEDS: [&str; 17] = [
    "method",
    "seeds",
    "decisions",
    "mean",
    "IQM",
    "at the last step",
    "during training",
    "forgetting: best earlier less final",
    "forgetting (Continual World)",
    "backward transfer (in pauses)",
    "forward transfer (GEM)",
    "assignment",
    "when groups come back",
    "policies",
    "rollouts of two groups",
    "dormant units",
    "seconds of learning",
];

/// Returns the table of statistics over seeds: success, forgetting, transfer and assignment.
fn over_seeds(methods: &[MethodRuns], groups: &[String]) -> ReportTable {
    let caption = format!(
        "Over seeds: mean and interquartile mean of success with intervals of 95 % by a bootstrap \
         over runs and placements; success during training is weighted by decisions; forgetting, \
         transfer and accuracy are means over seeds and the groups that have them: not over the \
         first group for forward transfer, nor over the last for forgetting. The mean output of a \
         dormant unit is at most {DORMANCY_THRESHOLD} of its layer's."
    );
    let mut table = ReportTable::new(&caption, &OVER_SEEDS);
    for method in methods {
        let row = over_seeds_row(&mut table, method, groups);
        table.rows.push(row);
    }
    table
}

fn over_seeds_row(table: &mut ReportTable, method: &MethodRuns, groups: &[String]) -> Vec<String> {
    let title = method_cell(table, method);
    let success = method.success(groups);
    let at_end = method.scores(groups, |group| group.success_at_end).pooled_statistic(mean);
    let with_interval = |statistic: fn(&[f64]) -> f64| {
        let interval = bracketed_interval(success.bootstrap_interval(statistic), 3);
        let score = success.pooled_statistic(statistic);
        score_text(score, format!("{score:.3}{interval}"))
    };
    let metrics = || method.metrics.iter();
    let mut mean_of = |metric: fn(&RunMetrics) -> Result<f64, UndefinedReason>| {
        mean_cell(table, &metrics().map(metric).collect::<Vec<_>>())
    };
    let seconds: Option<Vec<f64>> = method.runs.iter().map(RunData::training_seconds).collect();
    let (seeds, scored) = (method.runs.len(), success.min_seed_count());
    vec![
        title,
        if scored < seeds { format!("{scored} of {seeds}") } else { seeds.to_string() },
        range(metrics().map(|run| run.decisions)),
        with_interval(mean),
        with_interval(interquartile_mean),
        score_text(at_end, format!("{at_end:.3}")),
        mean_of(|run| run.training_success),
        mean_of(|run| run.mean_over_groups(|group| group.loss_from_best)),
        mean_of(|run| run.mean_over_groups(|group| group.forgetting)),
        mean_of(|run| run.mean_over_groups(|group| group.backward_transfer)),
        mean_of(|run| run.mean_over_groups(|group| group.forward_transfer)),
        mean_of(|run| run.assignment_accuracy),
        mean_of(|run| run.revisit_accuracy),
        range(metrics().map(|run| run.policy_count)),
        share(metrics().map(|run| run.rollout_and_switch_counts)),
        mean_of(|run| run.dormant_share),
        whole(seconds.map(|seconds| mean(&seconds))),
    ]
}

/// Returns the table that compares the first method with each of the others.
fn comparisons(methods: &[MethodRuns], groups: &[String]) -> ReportTable {
    let first = &methods[0];
    let header = [
        "against",
        "difference (Welch's t, 95 %)",
        "p (Welch's t)",
        "p (permutations of runs)",
        "over runs and placements, 95 %",
        "probability of improvement",
        "outcome",
        "in the paper (1)",
    ];
    let mut table = ReportTable::new("", &header);
    // the header holds the mark (1), so this must be the first note
    table.add_footnote(NOT_ONE_TO_ONE);
    table.caption = format!(
        "{} against the other methods, by success after the stream. A method is above or below if \
         both tests say so at 5 %, and equal if the difference lies within {EQUIVALENCE_MARGIN} by \
         two one-sided tests at 5 %.",
        method_cell(&mut table, first)
    );
    let printed = |method: &MethodRuns| {
        let row = method.preset_match.method.and_then(paper::paper_row);
        row.map(|row| row.average_success_and_reward.0)
    };
    for other in &methods[1..] {
        let (ours, theirs) = (first.success(groups), other.success(groups));
        let comparison = MethodComparison::new(&ours, &theirs);
        let difference = comparison.mean_difference;
        let improvement = ours.probability_of_improvement(&theirs);
        let welch = bracketed_interval(comparison.welch.map(|test| test.interval), 3);
        let bootstrap = bracketed_interval(ours.mean_difference_interval(&theirs), 3);
        let paper = printed(first).zip(printed(other));
        let against = method_cell(&mut table, other);
        table.rows.push(vec![
            against,
            score_text(difference, format!("{difference:+.3}{welch}")),
            p_value_cell(comparison.welch.map(|test| test.p_value)),
            p_value_cell(comparison.permutation_p_value),
            if bootstrap.is_empty() { empty_cell() } else { bootstrap.trim_start().to_owned() },
            score_text(improvement, format!("{improvement:.2}")),
            comparison.outcome().label().to_owned(),
            paper.map_or_else(empty_cell, |(one, two)| format!("{:+.2}", one - two)),
        ]);
    }
    table
}

/// Returns the table of success in each variant. Variants that were not seen in training are in
/// brackets.
fn variants(methods: &[MethodRuns], groups: &[String]) -> ReportTable {
    let elements = ["identity", "flip x", "flip y", "half turn"];
    let mut header = vec!["method", "group"];
    header.extend(elements);
    let caption = "Success in each variant, means over seeds; variants that were not seen in \
        training are in brackets.";
    let mut table = ReportTable::new(caption, &header);
    for method in methods {
        let name = method_cell(&mut table, method);
        for group in groups {
            let mut row = vec![name.clone(), group.clone()];
            row.extend(elements.map(|element| variant(&method.runs, group, element)));
            table.rows.push(row);
        }
    }
    table
}

fn variant(runs: &[RunData], group: &str, element: &str) -> String {
    let of = |run: &RunData| {
        let mut rows = run.last_scores();
        let row = rows.find(|row| row.group == group && row.element == element);
        row.map(|row| (row.success, row.seen_in_training))
    };
    let scores: Vec<(f64, bool)> = runs.iter().filter_map(of).collect();
    let successes: Vec<f64> = scores.iter().map(|score| score.0).collect();
    match scores.first() {
        None if runs.iter().all(|run| run.scores.is_empty()) => NOT_EVALUATED.to_owned(),
        None => empty_cell(),
        Some((_, true)) => format!("{:.3}", mean(&successes)),
        Some((_, false)) => format!("({:.3})", mean(&successes)),
    }
}

/// Returns the table of single runs, with one row for each.
fn runs(methods: &[MethodRuns], groups: &[String]) -> ReportTable {
    let mut header = vec!["run"];
    header.extend(groups.iter().map(String::as_str));
    header.extend(["average", "reward", "policies", "decisions", "seconds", "commit"]);
    let caption = "Success in each group and on average, and reward, after the stream, and what \
        they took.";
    let mut table = ReportTable::new(caption, &header);
    for method in methods {
        for (run, metrics) in method.runs.iter().zip(&method.metrics) {
            let of_groups = |metric: fn(&GroupMetrics) -> f64| -> Vec<f64> {
                let find = |name: &String| metrics.groups.iter().find(|group| group.group == *name);
                groups.iter().map(|name| find(name).map_or(f64::NAN, metric)).collect()
            };
            let success = of_groups(|group| group.success);
            let reward = mean(&of_groups(|group| group.reward));
            let remarks = method.preset_match.warning.clone().into_iter();
            let remarks = remarks.chain(unfinished_remark(run));
            let mut row = vec![with_footnotes(&mut table, &run.name, remarks)];
            let scores = success.iter().copied().chain([mean(&success)]);
            row.extend(scores.map(|score| score_text(score, format!("{score:.3}"))));
            row.extend([
                score_text(reward, format!("{reward:.1}")),
                metrics.policy_count.to_string(),
                metrics.decisions.to_string(),
                whole(run.training_seconds()),
                run.git_commits().join(", "),
            ]);
            table.rows.push(row);
        }
    }
    table
}

/// Formats a number without decimals, or a dash for `None`.
fn whole(number: Option<f64>) -> String {
    number.map_or_else(empty_cell, |number| format!("{number:.0}"))
}

/// Formats the smallest and the largest of some counts as "2 to 4", or the count if they agree.
fn range(counts: impl Iterator<Item = usize> + Clone) -> String {
    match (counts.clone().min(), counts.max()) {
        (Some(least), Some(most)) if least == most => least.to_string(),
        (Some(least), Some(most)) => format!("{least} to {most}"),
        _ => empty_cell(),
    }
}

fn share(rollouts: impl Iterator<Item = [usize; 2]>) -> String {
    let [all, spanning] = rollouts.fold([0, 0], |sum, run| [sum[0] + run[0], sum[1] + run[1]]);
    format!("{spanning} of {all}")
}
