//! Report as one self-contained HTML page.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use experiments::colours::line_colour;
use experiments::evaluation::EPISODES_SHOWN;
use experiments::{GroupFilm, RunData, TimingRow};
use itertools::Itertools;

use super::matrix::PolicyCountMatrix;
use super::method::MethodRuns;
use super::svg::escape_xml;
use super::table::Table;
use super::{curves, learning_curves};

/// Style sheet of the page, with a light and a dark theme.
const STYLE: &str = include_str!("page.css");
/// Script that shows titles of dots and cells as tooltips at once, and on a touch.
const SCRIPT: &str = include_str!("page.js");

/// Returns the HTML page of a report on these methods, scored on these groups, with these tables.
pub fn html_page(methods: &[MethodRuns], groups: &[String], tables: &[(&str, Table)]) -> String {
    let mut text = String::new();
    text.push_str(&section("Results", &tables_named(tables, &["results", "comparisons"])));
    text.push_str(&section("Learning", &learning(methods, groups, tables)));
    let rest = ["seeds", "visits", "variants", "recognition"];
    text.push_str(&section("Over the whole stream", &tables_named(tables, &rest)));
    let runs: Vec<&RunData> = methods.iter().flat_map(|method| &method.runs).collect();
    // a run that was scored once, after the stream, has no curve
    if runs.iter().any(|run| run.evaluation_rollouts().count() > 1) {
        let seeds = curves::seed_svgs(methods).into_iter();
        let seeds = seeds.map(|(seed, curve)| format!("<h3>Seed {seed}</h3>\n{}", wide(&curve)));
        text.push_str(&section("Each seed", &seeds.collect::<String>()));
    }
    // a single run is not folded away
    let open = if runs.len() == 1 { " open" } else { "" };
    let runs: String = runs.iter().map(|run| of_run(run, open)).collect();
    text.push_str(&section("Each run", &(tables_named(tables, &["runs"]) + &runs)));
    let names: Vec<&str> = methods.iter().map(|method| method.name.as_str()).collect();
    let title = escape_xml(&format!("Report on {}", names.join(", ")));
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<title>{title}</title>\n\
         <style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>\n{}{text}</main>\n\
         <script>\n{SCRIPT}</script>\n</body>\n</html>\n",
        command(methods)
    )
}

/// Returns a paragraph with the commands that started the runs, each command once.
fn command(methods: &[MethodRuns]) -> String {
    let runs = methods.iter().flat_map(|method| &method.runs);
    // later processes of a run have resumed it
    let first = runs.flat_map(|run| run.provenance.first());
    let commands: Vec<String> = first.map(|process| process.command.join(" ")).unique().collect();
    if commands.is_empty() {
        return String::new();
    }
    format!("<p>The runs were made by</p>\n<pre>{}</pre>\n", escape_xml(&commands.join("\n")))
}

fn section(title: &str, body: &str) -> String {
    format!("<section>\n<h2>{title}</h2>\n{body}</section>\n")
}

/// Wraps HTML in a box that scrolls on narrow screens.
fn wide(body: &str) -> String {
    format!("<div class=\"wide\">\n{body}</div>\n")
}

fn learning(methods: &[MethodRuns], groups: &[String], tables: &[(&str, Table)]) -> String {
    let drawings: Vec<String> = groups
        .iter()
        .filter_map(|group| learning_curves::group_curves_svg(methods, group))
        .collect();
    if drawings.is_empty() {
        return "<p>No learning curves: the runs were evaluated only at the end. \
            <code>evaluation.visit_rounds</code> and <code>evaluation.every</code> add \
            evaluations.</p>\n"
            .to_owned();
    }
    format!(
        "<p>Lines are means over seeds; bands go from the lowest seed to the highest. Of the \
         evaluations between which a group did not run the first one is shown; what was \
         forgotten since stands in the tables below.</p>\n\
         <div class=\"grid\">\n{}</div>\n{}",
        drawings.concat(),
        tables_named(tables, &["efficiency"])
    )
}

fn tables_named(tables: &[(&str, Table)], names: &[&str]) -> String {
    let named = names.iter().flat_map(|name| {
        let found = tables.iter().find(|(own, _)| own == name);
        found.map(|(_, table)| table.html())
    });
    named.collect()
}

fn of_run(run: &RunData, open: &str) -> String {
    let mut matrices = vec![PolicyCountMatrix::of_assignments(run)];
    matrices
        .extend(EPISODES_SHOWN.iter().filter_map(|&n| PolicyCountMatrix::of_recognitions(run, n)));
    let matrices: String = matrices.iter().map(PolicyCountMatrix::html).collect();
    format!(
        "<details{open}>\n<summary>{}</summary>\n{}<div class=\"row\">\n{matrices}</div>\n{}{}\
         <h4>Settings</h4>\n<pre>{}</pre>\n<h4>Where it ran</h4>\n<pre>{}</pre>\n</details>\n",
        escape_xml(&run.name),
        wide(&curves::run_svg(run)),
        films(run),
        time(&run.timings),
        escape_xml(&format!("{:#}", serde_json::json!(run.experiment))),
        escape_xml(&format!("{:#}", serde_json::json!(run.provenance))),
    )
}

/// Returns an HTML bar with the shares of time that the parts of learning took, without
/// evaluations.
fn time(timings: &[TimingRow]) -> String {
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
    let all_parts = parts.into_iter().chain([("the rest", rest.max(0.0))]);
    let bar = all_parts.enumerate().map(|(number, (name, seconds))| {
        let share = 100.0 * seconds / total;
        format!(
            "<span style=\"width:{share:.2}%;background:{}\" title=\"{name}: {seconds:.1} s, \
             {share:.1} %\">{name}</span>",
            line_colour(number)
        )
    });
    format!(
        "<h4>Where {total:.0} s of learning went</h4>\n<div class=\"bar\">{}</div>\n",
        bar.collect::<String>()
    )
}

/// Returns the HTML of a run's films, one below the other; empty if there are none.
fn films(run: &RunData) -> String {
    if run.films.is_empty() {
        return String::new();
    }
    let films: String = run.films.iter().map(film).collect();
    format!("<h4>Policies at work</h4>\n{films}")
}

fn film(film: &GroupFilm) -> String {
    let (group, size) = (escape_xml(&film.group), kilobytes(&film.gif));
    format!(
        "<p class=\"caption\">{group}: the four variants, each played by the policy that the \
         learner chose ({size} kB)</p>\n<div class=\"wide\"><img alt=\"{group}, played\" \
         src=\"data:image/gif;base64,{}\"></div>\n",
        STANDARD.encode(&film.gif)
    )
}

/// Returns the size of a GIF file in thousands of bytes, rounded up.
fn kilobytes(gif: &[u8]) -> usize {
    gif.len().div_ceil(1000)
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
        let bar = time(&[row, row]);
        assert!(bar.contains("4 s of learning"), "{bar}");
        for part in ["width:50.00%", "width:10.00%", "the rest: 0.2 s, 5.0 %"] {
            assert!(bar.contains(part), "{part}: {bar}");
        }
        assert_eq!(time(&[]), "");
    }

    #[test]
    fn a_page_needs_nothing_beside_it_and_escapes_names() {
        let mut run = RunData::empty("<b>-seed0", Budget::Smoke.experiment(Method::Covers));
        run.timings = vec![TimingRow::default()];
        let methods = MethodRuns::group_by_method(vec![run]).unwrap();
        let page = html_page(&methods, &[], &[]);
        assert!(page.contains("Report on &lt;b&gt;") && !page.contains("<b>"));
        for outside in ["src=", "href=", "url(", "@import"] {
            assert!(!page.contains(outside), "{outside}");
        }
    }

    #[test]
    fn a_run_shows_its_films_and_how_large_they_are() {
        let mut run = RunData::empty("run", Budget::Smoke.experiment(Method::Covers));
        assert_eq!(films(&run), "");
        run.films.push(GroupFilm { group: "a<b".to_owned(), gif: vec![0; 1001] });
        let page = films(&run);
        assert!(page.contains("a&lt;b") && page.contains("(2 kB)"), "{page}");
        assert!(page.contains("data:image/gif;base64,AAAA"));
    }
}
