//! Report as one self-contained HTML page.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use experiments::colours::curve_colour;
use experiments::evaluation::{RECOGNITION_EPISODE_COUNTS, mean};
use experiments::{GroupFilm, Provenance, RunData, TimingRow};
use itertools::Itertools;
use time::OffsetDateTime;

use super::charts::{
    IntervalEstimate, interval_svg, performance_profile_svg, statistic_by_method_svg, success_svg,
};
use super::format::{bracketed_interval, score_text, smoke_test_notice, unfinished_remark};
use super::matrix::PolicyConfusionMatrix;
use super::method::MethodRuns;
use super::metrics::{RunMetrics, UndefinedReason};
use super::preset_match::describe_settings;
use super::statistics::{MethodScores, interquartile_mean};
use super::svg::escape_xml;
use super::table::{ReportTable, code_html};
use super::{curves, learning_curves};

/// Style sheet of the page, with a light and a dark theme, and for paper.
const STYLE: &str = include_str!("page.css");
/// Script that sorts tables, stops films, and shows the figures behind dots and cells.
const SCRIPT: &str = include_str!("page.js");

/// Returns the self-contained HTML page of a report on these methods, with charts over these
/// groups, and these tables.
pub fn report_html(
    methods: &[MethodRuns],
    groups: &[String],
    tables: &[(&str, ReportTable)],
) -> String {
    let runs: Vec<&RunData> = methods.iter().flat_map(|method| &method.runs).collect();
    let stream = ["seeds", "visits", "variants", "recognition", "confusion"];
    let all = [
        (
            "Comparison",
            comparison(methods, groups) + &tables_named(tables, &["results", "comparisons"]),
        ),
        ("Learning", learning(methods, groups, tables)),
        ("Over the whole stream", tables_named(tables, &stream)),
        ("Each seed", each_seed(methods, &runs)),
        ("Each run", tables_named(tables, &["runs"]) + &each_run(methods)),
        ("How the runs were made", commands(&runs)),
    ];
    let sections = || all.iter().filter(|(_, body)| !body.is_empty()).enumerate();
    let links =
        sections().map(|(number, (title, _))| format!("<a href=\"#part-{number}\">{title}</a>\n"));
    let links: String = links.collect();
    let sections = sections().map(|(number, (title, body))| {
        format!(
            "<section id=\"part-{number}\">\n<h2><a href=\"#part-{number}\">{title}</a></h2>\n{body}\
             </section>\n"
        )
    });
    let sections: String = sections.collect();
    let title = escape_xml(&title(methods));
    let overview = overview(methods, groups);
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<title>{title}</title>\n\
         <style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>\n{overview}\
         <nav aria-label=\"Contents\">\n{links}</nav>\n{sections}</main>\n\
         <script>\n{SCRIPT}</script>\n</body>\n</html>\n"
    )
}

/// Largest number of task groups that the title names.
const MAX_TITLE_GROUPS: usize = 4;

/// Returns the page's title: a single method in words, or as its folder is named, with the task
/// groups of its stream; or the names of several methods.
fn title(methods: &[MethodRuns]) -> String {
    if let [method] = methods {
        let run = || format!("Run {}", method.name);
        let words = method.preset_match.method_in_words().unwrap_or_else(run);
        let groups = &method.runs[0].experiment.schedule.groups;
        if groups.len() > MAX_TITLE_GROUPS {
            return format!("{words}: {}", with_plural(groups.len(), "task group"));
        }
        return format!("{words}: {}", groups.iter().map(|visit| &visit.group).join(", "));
    }
    let names: Vec<&str> = methods.iter().map(|method| method.name.as_str()).collect();
    match names[..] {
        [first, _, _, _, ..] => format!("Report on {first} and {} other methods", names.len() - 1),
        _ => format!("Report on {}", names.join(", ")),
    }
}

/// Returns a number with its noun, which gets an `s` unless the number is 1.
fn with_plural(number: usize, noun: &str) -> String {
    let ending = if number == 1 { "" } else { "s" };
    format!("{number} {noun}{ending}")
}

/// Returns the first screen: three figures of the first method, all methods with intervals, their
/// learning curves, and a film.
fn overview(methods: &[MethodRuns], groups: &[String]) -> String {
    let first = &methods[0];
    let success = first.success(groups);
    let (count, seeds) = (groups.len(), success.min_seed_count());
    // left out where no run knows it
    let known = |metric: fn(&RunMetrics) -> Result<f64, UndefinedReason>, meaning: &str| {
        let known: Vec<f64> = first.metrics.iter().filter_map(|run| metric(run).ok()).collect();
        (!known.is_empty()).then(|| (format!("{:.3}", mean(&known)), meaning.to_owned()))
    };
    let interval = bracketed_interval(success.bootstrap_interval(mean), 2);
    let mean_success = success.pooled_statistic(mean);
    let scope =
        format!("{interval}, {}, {}", with_plural(count, "group"), with_plural(seeds, "seed"));
    let scope = if groups.is_empty() { String::new() } else { scope };
    let figures = [
        Some((
            score_text(mean_success, format!("{mean_success:.3}")),
            format!("success after the stream{scope}"),
        )),
        known(|run| run.training_success, "success in training, while exploring")
            .filter(|_| mean_success.is_nan()),
        known(|run| run.assignment_accuracy, "of the rollouts went to the policy of their group"),
        known(
            |run| run.mean_over_groups(|group| group.forgetting),
            "of success was lost after a group's last visit",
        ),
    ];
    let figures: Vec<String> = figures
        .into_iter()
        .flatten()
        .map(|(figure, meaning)| format!("<div><dt>{meaning}</dt><dd>{figure}</dd></div>\n"))
        .collect();
    let film = methods.iter().flat_map(|method| &method.runs).find_map(|run| run.films.first());
    let notice = smoke_test_notice(methods);
    let notice = notice.map(|notice| format!("<p class=\"warning\">{notice}</p>\n"));
    format!(
        "{}<dl class=\"figures\">\n{}</dl>\n<div class=\"grid\">\n{}{}{}\
         </div>\n",
        notice.unwrap_or_default(),
        figures.concat(),
        success_chart(methods, groups),
        stream_curves(methods),
        film.map_or_else(String::new, film_html)
    )
}

/// Returns the chart of success; says why intervals are missing, if any are.
fn success_chart(methods: &[MethodRuns], groups: &[String]) -> String {
    let lacks_interval = |method: &MethodRuns| method.success(groups).min_seed_count() < 2;
    let note = if methods.iter().any(lacks_interval) {
        "An interval needs two or more evaluated seeds of a method."
    } else {
        ""
    };
    captioned_chart_html(&success_svg(methods, groups), note)
}

/// Returns learning curves over the stream, or curves of success in training where evaluations are
/// too few for these; without either, says why.
fn stream_curves(methods: &[MethodRuns]) -> String {
    const TRAINING: &str = "Success of the episodes that methods trained on, while exploring: a \
        curve of evaluations needs two of them.";
    if let Some(svg) = learning_curves::stream_learning_curves_svg(methods) {
        return chart_html(&svg);
    }
    learning_curves::training_curves_svg(methods).map_or_else(
        || "<p>No curve: episodes ended in fewer than two rollouts.</p>\n".to_owned(),
        |svg| captioned_chart_html(&svg, TRAINING),
    )
}

/// Returns rliable's charts: interquartile means, probabilities of improvement, and performance
/// profiles. Empty for one method.
fn comparison(methods: &[MethodRuns], groups: &[String]) -> String {
    let [first, others @ ..] = methods else {
        return String::new();
    };
    if others.is_empty() {
        return String::new();
    }
    let scores: Vec<MethodScores> = methods.iter().map(|method| method.success(groups)).collect();
    let better = others.iter().zip(&scores[1..]).map(|(other, own)| {
        let value = scores[0].probability_of_improvement(own);
        IntervalEstimate { name: &other.name, value, interval: None }
    });
    let title = format!("Probability that a run of {} is better than one of", first.name);
    let better = better.collect::<Vec<_>>();
    let better = interval_svg(&title, "probability of improvement", &better, 1, Some(0.5));
    let middle = "Interquartile mean of success";
    let middle = statistic_by_method_svg(
        middle,
        "interquartile mean of success",
        methods,
        groups,
        interquartile_mean,
    );
    let charts =
        [middle, better, performance_profile_svg(methods, &scores)].map(|svg| chart_html(&svg));
    format!("<div class=\"grid\">\n{}</div>\n", charts.concat())
}

/// Wraps a drawing, whose points can be read with the arrow keys, in a box that scrolls on narrow
/// screens.
fn chart_html(svg: &str) -> String {
    captioned_chart_html(svg, "")
}

/// Wraps a drawing as [`chart_html`] does, with a caption below it unless that is empty.
fn captioned_chart_html(svg: &str, caption: &str) -> String {
    let caption = match caption {
        "" => String::new(),
        text => format!("<figcaption>{text}</figcaption>\n"),
    };
    format!("<figure class=\"scroll chart\" tabindex=\"0\">\n{svg}{caption}</figure>\n")
}

/// Returns the commands that started the runs, each command once.
fn commands(runs: &[&RunData]) -> String {
    // later processes of a run have resumed it
    let first = runs.iter().flat_map(|run| run.provenance.first());
    let commands: Vec<String> = first.map(|process| process.command.join(" ")).unique().collect();
    if commands.is_empty() {
        return String::new();
    }
    format!("<pre tabindex=\"0\">{}</pre>\n", escape_xml(&commands.join("\n")))
}

fn learning(methods: &[MethodRuns], groups: &[String], tables: &[(&str, ReportTable)]) -> String {
    let drawings = groups
        .iter()
        .filter_map(|group| learning_curves::group_learning_curves_svg(methods, group));
    let drawings: String = drawings.map(|svg| chart_html(&svg)).collect();
    if drawings.is_empty() {
        return "<p>No learning curves of single groups: these need two evaluations between which \
            the group ran. <code>evaluation.visit_rounds</code> and <code>evaluation.every</code> \
            add evaluations.</p>\n"
            .to_owned();
    }
    format!(
        "<p>Lines are means over seeds; bands go from the lowest seed to the highest. Of the \
         evaluations between which a group did not run the first one is shown; what was \
         forgotten since stands in the tables below.</p>\n\
         <div class=\"grid\">\n{drawings}</div>\n{}",
        tables_named(tables, &["efficiency"])
    )
}

fn tables_named(tables: &[(&str, ReportTable)], names: &[&str]) -> String {
    let named = names.iter().flat_map(|name| {
        let found = tables.iter().find(|(own, _)| own == name);
        found.map(|(_, table)| table.html())
    });
    named.collect()
}

/// Returns the curves of each seed; empty where runs were scored once, after the stream.
fn each_seed(methods: &[MethodRuns], runs: &[&RunData]) -> String {
    if runs.iter().all(|run| run.rollouts_before_evaluations().count() < 2) {
        return String::new();
    }
    let seeds = curves::success_svg_per_seed(methods).into_iter();
    let seeds = seeds.map(|(seed, svg)| format!("<h3>Seed {seed}</h3>\n{}", chart_html(&svg)));
    seeds.collect()
}

fn each_run(methods: &[MethodRuns]) -> String {
    let runs = || methods.iter().flat_map(|method| method.runs.iter().zip(&method.nearest_presets));
    // a single run is not folded away
    let open = if runs().count() == 1 { " open" } else { "" };
    let settings = |run: &RunData, nearest| describe_settings(nearest, &run.experiment);
    runs().map(|(run, nearest)| of_run(run, &settings(run, nearest), open)).collect()
}

fn of_run(run: &RunData, settings: &str, open: &str) -> String {
    let mut matrices = vec![PolicyConfusionMatrix::of_assignments(run)];
    matrices.extend(
        RECOGNITION_EPISODE_COUNTS
            .iter()
            .filter_map(|&n| PolicyConfusionMatrix::of_recognitions(run, n)),
    );
    let matrices: String = matrices.iter().map(PolicyConfusionMatrix::html).collect();
    let unfinished =
        unfinished_remark(run).map(|remark| format!("<p>{}.</p>\n", escape_xml(&remark)));
    format!(
        "<details{open}>\n<summary>{}</summary>\n{}{}<div class=\"row\">\n{matrices}</div>\n{}{}\
         <h3>Settings</h3>\n<p>{}. All are in the run's <code>experiment.json</code>.</p>\n{}</details>\n",
        escape_xml(&run.name),
        unfinished.unwrap_or_default(),
        chart_html(&curves::run_curves_svg(run)),
        films(run),
        time_bar(&run.timings),
        code_html(settings),
        processes(&run.provenance)
    )
}

/// Returns when and where each process worked on a run.
fn processes(provenance: &[Provenance]) -> String {
    let line = |process: &Provenance| {
        let Provenance { threads, processor, renderer, mujoco_version, operating_system, .. } =
            process;
        let (commit, gpu) = (process.commit.as_deref(), process.gpu.as_deref());
        let line = format!(
            "{}, after {} rollouts: {operating_system}, {processor}, {threads} threads, {}MuJoCo \
             {mujoco_version}, {renderer}, version {} (commit {})",
            date(process.started_unix_s),
            process.rollouts_before,
            gpu.map_or_else(String::new, |gpu| format!("updates on {gpu}, ")),
            process.covers_version,
            commit.unwrap_or("unknown"),
        );
        format!("<li>{}</li>\n", escape_xml(&line))
    };
    let lines: String = provenance.iter().map(line).collect();
    if lines.is_empty() { lines } else { format!("<h3>Where it ran</h3>\n<ul>\n{lines}</ul>\n") }
}

/// Formats seconds since 1970 as a date with the time in UTC.
fn date(unix_s: i64) -> String {
    OffsetDateTime::from_unix_timestamp(unix_s).map_or_else(
        |_| format!("{unix_s} s after 1970"),
        |time| format!("{} {:02}:{:02} UTC", time.date(), time.hour(), time.minute()),
    )
}

/// Returns a bar with the shares of time that the parts of learning took, without evaluations.
fn time_bar(timings: &[TimingRow]) -> String {
    let sum = |part: fn(&TimingRow) -> f64| timings.iter().map(part).sum::<f64>();
    let total = sum(|row| row.total);
    if total <= 0.0 {
        return String::new();
    }
    let parts = [
        ("environments", sum(|row| row.environments)),
        ("decisions", sum(|row| row.inference)),
        ("assignment", sum(|row| row.assignment)),
        ("updates", sum(|row| row.update)),
    ];
    let rest = total - parts.iter().map(|part| part.1).sum::<f64>();
    let mut bar = String::new();
    let mut names = Vec::new();
    let mut from = 0.0;
    for (number, (name, seconds)) in
        parts.into_iter().chain([("the rest", rest.max(0.0))]).enumerate()
    {
        let (share, colour) = (100.0 * seconds / total, curve_colour(number));
        bar += &format!(
            "<rect x=\"{from:.2}\" width=\"{share:.2}\" height=\"4\" fill=\"{colour}\"><title>{name}: \
             {seconds:.1} s, {share:.1} %</title></rect>"
        );
        names.push(format!(
            "<svg class=\"key\" viewBox=\"0 0 1 1\" aria-hidden=\"true\"><rect width=\"1\" height=\"1\" \
             fill=\"{colour}\"/></svg> {name} {share:.0} %"
        ));
        from += share;
    }
    format!(
        "<h3>Where {total:.0} s of learning went</h3>\n<svg class=\"bar\" viewBox=\"0 0 100 4\" \
         preserveAspectRatio=\"none\" role=\"img\"><title>Shares of the time</title>{bar}</svg>\n<p>{}</p>\n",
        names.join(" &ensp;")
    )
}

/// Returns the HTML of a run's films, one below the other; empty if there are none.
fn films(run: &RunData) -> String {
    if run.films.is_empty() {
        return String::new();
    }
    let films: String = run.films.iter().map(film_html).collect();
    format!("<h3>Policies at work</h3>\n{films}")
}

fn film_html(film: &GroupFilm) -> String {
    let (group, size) = (escape_xml(&film.group), film.gif.len().div_ceil(1000));
    format!(
        "<figure class=\"film\">\n<figcaption>{group}: the four variants, each played by the policy that \
         the learner chose ({size} kB)</figcaption>\n<img alt=\"{group}, played\" \
         src=\"data:image/gif;base64,{}\">\n</figure>\n",
        STANDARD.encode(&film.gif)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use experiments::presets::{Budget, Method};

    #[test]
    fn the_parts_of_the_time_make_up_the_whole() {
        let row = TimingRow {
            total: 2.0,
            environments: 1.0,
            inference: 0.2,
            assignment: 0.1,
            update: 0.6,
            ..TimingRow::default()
        };
        let bar = time_bar(&[row, row]);
        assert!(bar.contains("4 s of learning"), "{bar}");
        for part in ["width=\"50.00\"", "decisions 10 %", "the rest: 0.2 s, 5.0 %"] {
            assert!(bar.contains(part), "{part}: {bar}");
        }
        assert_eq!(time_bar(&[]), "");
    }

    #[test]
    fn a_page_needs_nothing_beside_it_and_escapes_names() {
        let mut run = RunData::empty("<b>-seed0", Budget::Smoke.preset_experiment(Method::Covers));
        run.timings = vec![TimingRow::default()];
        let methods = MethodRuns::group_by_method(vec![run]).unwrap();
        let page = report_html(&methods, &[], &[]);
        assert!(page.contains("&lt;b&gt;") && !page.contains("<b>"));
        for outside in ["src=", "href=\"http", "url(", "@import"] {
            assert!(!page.contains(outside), "{outside}");
        }
    }

    #[test]
    fn a_run_shows_its_films_and_how_large_they_are() {
        let mut run = RunData::empty("run", Budget::Smoke.preset_experiment(Method::Covers));
        assert_eq!(films(&run), "");
        run.films.push(GroupFilm { group: "a<b".to_owned(), gif: vec![0; 1001] });
        let page = films(&run);
        assert!(page.contains("a&lt;b") && page.contains("(2 kB)"), "{page}");
        assert!(page.contains("data:image/gif;base64,AAAA"));
    }
}
