//! `docs/results/table1` and `docs/results/efficiency` are what reports make of the runs that are
//! kept, and the page of the table quotes its report.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use covers::RunData;
use covers::report::Report;

use crate::common::scratch::Scratch;

/// The report of the kept runs, in the order of the kept tables.
static REPORT: LazyLock<Report> = LazyLock::new(|| {
    let scratch = Scratch::new("kept");
    let data = unpacked("table.tar.gz", &scratch.0);
    let runs = kept_runs().into_iter().map(|name| data.join(name));
    Report::new(runs.map(|run| RunData::read(&run).unwrap()).collect()).unwrap()
});

fn results() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/results")
}

fn archives() -> Vec<String> {
    let names = files(&results().join("data"));
    names.into_iter().filter(|name| name.ends_with(".tar.gz")).collect()
}

/// Unpacks an archive of runs, which is one folder, and returns that folder.
fn unpacked(archive: &str, into: &Path) -> PathBuf {
    let mut tar = Command::new("tar");
    tar.arg("-C").arg(into).arg("-xzf");
    let status = tar.arg(results().join("data").join(archive)).status();
    assert!(status.unwrap().success(), "{archive}");
    let study = archive.trim_end_matches(".tar.gz");
    into.join(study.trim_start_matches("efficiency-"))
}

/// Names of the runs, of which a mark may follow.
fn kept_runs() -> Vec<String> {
    let table = fs::read_to_string(results().join("table1/runs.csv")).unwrap();
    let rows = table.lines().skip(1).map(|row| row.trim_start_matches('"'));
    let names = rows.map(|row| row.split(['"', ' ']).next().unwrap());
    names.map(str::to_owned).collect()
}

fn files(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.collect();
    names.sort();
    names
}

/// Tables in Markdown, each as it stands.
fn tables(text: &str) -> Vec<String> {
    let paragraphs = text.split("\n\n").map(|paragraph| {
        let rows = paragraph.lines().filter(|line| line.starts_with('|'));
        rows.collect::<Vec<_>>().join("\n")
    });
    paragraphs.filter(|table| !table.is_empty()).collect()
}

/// Tables of a page that the report does not have.
fn edited(page: &str, report: &str) -> Vec<String> {
    let made = tables(report);
    let quoted = tables(page).into_iter();
    quoted.filter(|table| !made.contains(table)).collect()
}

#[test]
fn studies_are_those_of_the_kept_runs() {
    let kept = results().join("efficiency");
    let scratch = Scratch::new("studies");
    let all = archives();
    let archived = all.iter().filter(|name| name.starts_with("efficiency-"));
    let folders: Vec<PathBuf> = archived.map(|name| unpacked(name, &scratch.0)).collect();
    let studies = files(&scratch.0);
    assert!(studies.len() > 3 && studies.len() == folders.len());
    assert_eq!(files(&kept), studies, "`make efficiency` takes all studies");
    for study in studies {
        let folder = scratch.0.join(&study);
        let runs = files(&folder).into_iter().map(|run| folder.join(run));
        let runs = runs.map(|run| RunData::read(&run).unwrap()).collect();
        let made = Scratch::new("study");
        Report::new(runs).unwrap().write(&made.0).unwrap();
        let files = files(&kept.join(&study));
        assert!(files.len() > 3, "{study}");
        for name in files {
            let text = |source: &Path| fs::read_to_string(source.join(&name)).unwrap();
            let same = text(&made.0) == text(&kept.join(&study));
            assert!(same, "`make efficiency` makes another {name} of {study}");
        }
    }
}

#[test]
fn tables_and_drawings_are_those_of_the_kept_runs() {
    let mut runs = kept_runs();
    runs.sort();
    let scratch = Scratch::new("table");
    let data = unpacked("table.tar.gz", &scratch.0);
    assert_eq!(runs, files(&data), "`make table1` takes all runs");

    let (kept, made) = (results().join("table1"), Scratch::new("table1"));
    REPORT.write(&made.0).unwrap();
    let text = |folder: &Path, name: &str| fs::read_to_string(folder.join(name)).ok();
    let of_all = |name: &str| name.starts_with("seed") && name.ends_with(".svg");
    let expected = files(&made.0)
        .into_iter()
        .filter(|name| name.ends_with(".csv") || of_all(name) || kept.join(name).exists());
    let expected: Vec<String> = expected.collect();
    assert_eq!(files(&kept), expected, "`make table1` makes all");
    for name in &expected {
        let same = text(&made.0, name) == text(&kept, name);
        assert!(same, "`make table1` makes another {name}");
    }
}

/// Counted from the policies in `evaluation.csv` and `metrics.csv`; these runs did not record the
/// scores of the groups' own policies.
#[test]
fn other_groups_policies_played_for_ordinary_networks() {
    let report = REPORT.markdown();
    let results = tables(&report).remove(0);
    let rows = results.lines().map(|line| line.split(" | ").collect());
    let rows: Vec<Vec<&str>> = rows.collect();
    for (method, mismatches) in [
        ("covers", "0 of 80"),
        ("3rl", "0 of 48"),
        ("covers-gt", "0 of 80"),
        ("covers-cnn", "17 of 80"),
        ("covers-cnn-slim", "23 of 80"),
        ("equi-sac", "0 of 48"),
    ] {
        let name = format!("| {method}");
        let row = rows.iter().find(|row| row[0] == name).unwrap();
        let [average, own, counted] = row[5..] else { panic!("{row:?}") };
        assert_eq!(counted, format!("{mismatches} |"), "{method}");
        let (success, rest) = average.split_once(" [").unwrap();
        let reward = rest.split_once("] ").unwrap().1;
        if mismatches.starts_with("0 ") {
            assert_eq!(own, format!("{success} {reward}"), "{method}");
        } else {
            assert_eq!(own, "- (2)", "{method}");
        }
    }
}

#[test]
fn the_page_quotes_tables_of_the_report() {
    let page = fs::read_to_string(results().join("table1.md")).unwrap();
    let report = REPORT.markdown();
    assert_eq!(edited(&page, &report), <[String; 0]>::default());
    assert!(tables(&page).len() > 3, "{page}");
    let better = report.replacen("| 0.9", "| 1.0", 1);
    assert_eq!(edited(&better, &report).len(), 1);
}
