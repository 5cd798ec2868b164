//! What `covers report` says of runs, and what it refuses.

use std::fs;
use std::path::Path;

use covers::experiments::printable::printable_message;
use covers::presets::{Budget, Method};
use covers::watch::WatchOptions;
use covers::{CoversError, Experiment, Run, RunFolder, RunSummary};
use envs::Embodiment;

use crate::common::{covers, scratch::Scratch};

impl Scratch {
    /// Runs to the end in a folder of this name.
    fn run(&self, name: &str, experiment: Experiment) -> RunSummary {
        let folder = RunFolder::create(&self.0, name).unwrap();
        let mut run = Run::start(experiment, folder).unwrap();
        while run.advance().unwrap().is_some() {}
        run.summary().unwrap().unwrap()
    }

    /// A run of an older version, whose summary holds no checksums of its tables.
    fn run_without_checksums(&self, name: &str, experiment: Experiment) {
        self.run(name, experiment);
        let path = self.0.join(name).join("summary.json");
        let text = fs::read_to_string(&path).unwrap();
        let mut summary: serde_json::Value = serde_json::from_str(&text).unwrap();
        summary.as_object_mut().unwrap().remove("tables").unwrap();
        fs::write(path, summary.to_string()).unwrap();
    }

    fn report(&self, names: &[&str], more: &[&str]) -> Result<String, CoversError> {
        let folders = names.iter().map(|name| self.0.join(name));
        let folders: Vec<String> = folders.map(|path| path.display().to_string()).collect();
        let folders: Vec<&str> = folders.iter().map(String::as_str).collect();
        covers(&[&["report"], &folders[..], more].concat())
    }

    fn refusal(&self, names: &[&str]) -> String {
        self.report(names, &[]).unwrap_err().to_string()
    }
}

/// A smoke run of two groups that is scored all along.
fn small(method: Method, seed: u64) -> Experiment {
    let mut experiment = Budget::Smoke.preset_experiment(method).with_seed(seed);
    experiment.schedule.groups.truncate(2);
    experiment.evaluation.visit_episodes_per_env = 1;
    experiment.with_threads(2)
}

/// The same with one group and without an arm, which takes less time and is no preset.
fn alone(method: Method, seed: u64) -> Experiment {
    let mut experiment = small(method, seed).with_embodiment(Embodiment::FLOATING_HAND);
    experiment.schedule.groups.truncate(1);
    experiment
}

/// The mean over a run's groups.
fn average(summary: &RunSummary, figure: fn(&covers::evaluation::GroupScore) -> f64) -> f64 {
    let groups = summary.groups.iter().map(figure);
    groups.sum::<f64>() / summary.groups.len() as f64
}

/// The cells of a report's tables.
struct Rows<'a>(Vec<Vec<&'a str>>);

impl<'a> Rows<'a> {
    fn of(text: &'a str) -> Self {
        let rows = text.lines().filter_map(|line| line.strip_prefix("| "));
        let rows = rows.filter_map(|row| row.strip_suffix(" |"));
        Self(rows.map(|row| row.split(" | ").collect()).collect())
    }

    /// The row that begins with these cells, of the table with so many columns.
    fn find(&self, first: &[&str], columns: usize) -> &[&'a str] {
        let mut rows = self.0.iter();
        let found = rows.find(|row| row.starts_with(first) && row.len() == columns);
        found.unwrap()
    }
}

/// What it says of two runs of COVERS.
fn check_covers(rows: &Rows, runs: &[RunSummary]) {
    let row = rows.find(&["covers"], 17);
    let mean =
        |figure: &dyn Fn(&RunSummary) -> f64| f64::midpoint(figure(&runs[0]), figure(&runs[1]));
    let success = mean(&|summary| average(summary, |group| group.success));
    // without an interval if both runs have the same success
    assert!(row[3].starts_with(&format!("{success:.3}")));
    let accuracy = mean(&|summary| summary.assignment_accuracy.unwrap());
    assert_eq!(row[11], format!("{accuracy:.3}"));
    let decisions = rows.find(&["covers-seed1"], 9)[6];
    assert_eq!(decisions, runs[1].decisions.to_string());
    let recognised: f64 = rows.find(&["covers", "1"], 6)[4].parse().unwrap();
    assert!((0.0..=1.0).contains(&recognised), "{recognised}");
}

/// What it says of one run of CNN, which has one policy.
fn check_cnn(rows: &Rows, run: &RunSummary) {
    let row = rows.find(&["cnn"], 17);
    let success = average(run, |group| group.success);
    assert_eq!(row[3], format!("{success:.3}"));
    assert!(row[11].starts_with("- ("), "one policy has no accuracy");
    let is_recognition = |of: &Vec<&str>| of.starts_with(&["cnn", "1"]) && of.len() == 6;
    assert!(!rows.0.iter().any(is_recognition), "one policy is not asked");
    assert_eq!(rows.find(&["cnn"], 8)[6], "too few seeds (two of each are needed)");
    let reward = average(run, |group| group.reward);
    let printed = rows.find(&["cnn-seed0"], 9)[4];
    assert_eq!(printed, format!("{reward:.1}"));
}

#[test]
fn a_report_says_what_the_runs_files_say() {
    let scratch = Scratch::new("says");
    let runs = ["covers-seed0", "covers-seed1", "cnn-seed0"];
    let methods = [(Method::Covers, 0), (Method::Covers, 1), (Method::Cnn, 0)];
    let summaries: Vec<RunSummary> = runs
        .iter()
        .zip(methods)
        .map(|(name, (method, seed))| scratch.run(name, small(method, seed)))
        .collect();
    let out = scratch.0.join("out");
    let text = scratch.report(&runs, &["--out", out.to_str().unwrap()]).unwrap();
    let rows = Rows::of(&text);
    check_covers(&rows, &summaries[..2]);
    check_cnn(&rows, &summaries[2]);
    for method in ["covers", "cnn"] {
        let dormant: f64 = rows.find(&[method], 17)[15].parse().unwrap();
        assert!((0.0..1.0).contains(&dormant), "{dormant}");
    }
    assert!(text.contains("covers in the paper (1)") && text.contains("one to one"));
    let notice = "These runs are as short as those of the smoke budget";
    assert!(text.starts_with(&format!("**{notice}")), "{text}");
    let files = |name: &str| fs::read_to_string(out.join(name)).unwrap();
    let (tables, address) = text.split_once("\n\npage: ").unwrap();
    assert_eq!(files("report.md").trim_end(), tables);
    assert_eq!(address.trim_end(), out.join("report.html").to_str().unwrap());
    assert!(files("results.csv").contains("\"covers\"") && files("seeds.tex").contains("toprule"));
    let page = files("report.html");
    for part in [
        "<summary>covers-seed1</summary>",
        &format!("<p class=\"warning\">{notice}"),
        "Rollouts of each group",
        "of learning went",
        "<h3>Seed 1</h3>",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("<details open>"));
    for drawing in ["covers-seed0.svg", "seed0.svg", "learning-goal-reach.svg"] {
        assert!(files(drawing).contains("goal-reach"), "{drawing}");
    }
}

#[test]
fn files_that_cannot_be_are_refused() {
    let scratch = Scratch::new("files");
    scratch.run_without_checksums("covers-seed0", alone(Method::Covers, 0));
    let file = |name: &str| scratch.0.join("covers-seed0").join(name);
    let scores = fs::read(file("evaluation.csv")).unwrap();
    fs::remove_file(file("evaluation.csv")).unwrap();
    assert!(scratch.refusal(&["covers-seed0"]).contains("evaluation.csv"));
    fs::write(file("evaluation.csv"), scores).unwrap();
    scratch.report(&["covers-seed0"], &[]).unwrap();
    let last = "the last rows of";
    for (name, column, wrong, problem) in [
        ("evaluation.csv", "rollouts", "1", last),
        ("evaluation.csv", "decisions", "1", "about decisions"),
        ("evaluation.csv", "element", "flip y", "twice"),
        ("evaluation.csv", "element", "turn", "cannot be"),
        ("evaluation.csv", "success", "NaN", "cannot be"),
        ("evaluation.csv", "episodes", "18446744073709551615", "cannot be"),
        ("evaluation.csv", "own_policy", "1", "own policies"),
        ("evaluation.csv", "own_success", "", "cannot be"),
        ("evaluation.csv", "own_reward", "inf", "cannot be"),
        ("units.csv", "rollouts", "1", last),
        ("units.csv", "dormant", "4294967295", "cannot be"),
        ("recognition.csv", "group", "no-group", "cannot be"),
        ("recognition.csv", "episodes", "3", "cannot be"),
        ("recognition.csv", "times", "4294967296", "cannot be"),
    ] {
        let table = fs::read_to_string(file(name)).unwrap();
        fs::write(file(name), with_cell(&table, column, wrong)).unwrap();
        let refusal = scratch.refusal(&["covers-seed0"]);
        assert!(refusal.contains(name) && refusal.contains(problem), "{refusal}");
        fs::write(file(name), table).unwrap();
    }
    // scores before the stream that tell another number of decisions than none
    let table = fs::read_to_string(file("evaluation.csv")).unwrap();
    assert!(table.contains("\n0,0,"), "{table}");
    fs::write(file("evaluation.csv"), table.replacen("\n0,0,", "\n0,1,", 1)).unwrap();
    let refusal = scratch.refusal(&["covers-seed0"]);
    assert!(refusal.contains("about decisions"), "{refusal}");
}

#[test]
fn a_run_in_progress_is_reported_as_far_as_it_was_evaluated() {
    let scratch = Scratch::new("progress");
    scratch.run("covers-seed0", alone(Method::Covers, 0));
    let file = |name: &str| scratch.0.join("covers-seed0").join(name);
    fs::remove_file(file("summary.json")).unwrap();
    let text = scratch.report(&["covers-seed0"], &[]).unwrap();
    assert!(text.contains("covers-seed0 is not finished: it took "), "{text}");
    // the last evaluation is being written
    let scores = fs::read_to_string(file("evaluation.csv")).unwrap();
    let last = scores.lines().last().unwrap();
    let whole = &scores[..scores.len() - last.len() - 1];
    fs::write(file("evaluation.csv"), whole).unwrap();
    scratch.report(&["covers-seed0"], &[]).unwrap();
    // a score that cannot be
    fs::write(file("evaluation.csv"), with_cell(&scores, "success", "7.5")).unwrap();
    assert!(scratch.refusal(&["covers-seed0"]).contains("cannot be"));
    // after a power cut, scores may be of rollouts that were lost
    fs::write(file("evaluation.csv"), &scores).unwrap();
    let rollouts = fs::read_to_string(file("metrics.csv")).unwrap();
    let (kept, _) = rollouts.trim_end().rsplit_once('\n').unwrap();
    fs::write(file("metrics.csv"), format!("{kept}\n")).unwrap();
    scratch.report(&["covers-seed0"], &[]).unwrap();
    let header = scores.lines().next().unwrap();
    fs::write(file("evaluation.csv"), format!("{header}\n")).unwrap();
    let unevaluated = scratch.report(&["covers-seed0"], &[]).unwrap();
    assert!(unevaluated.contains("not evaluated yet"), "{unevaluated}");
}

/// A last cell that is cut short would pass for another number.
#[test]
fn tables_that_are_cut_off_or_count_twice_are_refused() {
    let scratch = Scratch::new("cut");
    scratch.run_without_checksums("covers-seed0", alone(Method::Covers, 0));
    for name in ["metrics.csv", "evaluation.csv", "units.csv", "recognition.csv", "timings.csv"] {
        let file = scratch.0.join("covers-seed0").join(name);
        let whole = fs::read_to_string(&file).unwrap();
        let twice = format!("{whole}{}\n", whole.lines().last().unwrap());
        let cut = [1, 3].map(|cut| (&whole[..whole.len() - cut], "cut off"));
        let has_keys = !["metrics.csv", "timings.csv"].contains(&name);
        for (damaged, problem) in cut.into_iter().chain(has_keys.then_some((&twice[..], "twice"))) {
            fs::write(&file, damaged).unwrap();
            let refusal = scratch.refusal(&["covers-seed0"]);
            assert!(refusal.contains(name) && refusal.contains(problem), "{refusal}");
        }
        fs::write(&file, whole).unwrap();
    }
    scratch.report(&["covers-seed0"], &[]).unwrap();
}

#[test]
fn answers_are_as_many_as_the_run_asked_for() {
    let scratch = Scratch::new("answers");
    scratch.run_without_checksums("covers-seed0", alone(Method::Covers, 0));
    let file = scratch.0.join("covers-seed0/recognition.csv");
    let whole = fs::read_to_string(&file).unwrap();
    let lines: Vec<&str> = whole.split_inclusive('\n').collect();
    assert_eq!(lines.len(), 1 + 4 * 3, "{whole}");
    let doubled = whole.replace(",1\n", ",2\n");
    assert_ne!(doubled, whole);
    let other = lines[1].replace("goal-reach,", "goal-reach,turn");
    for damaged in [
        lines[..7].concat(),
        lines[..12].concat(),
        lines[0].to_owned(),
        String::new(),
        doubled,
        whole.repeat(2),
        whole.clone() + &lines[1..].concat(),
        whole.clone() + &other,
    ] {
        fs::write(&file, &damaged).unwrap();
        let refusal = scratch.refusal(&["covers-seed0"]);
        assert!(refusal.contains("recognition.csv"), "{refusal}: {damaged}");
    }
    // older runs asked for nothing
    fs::remove_file(&file).unwrap();
    scratch.report(&["covers-seed0"], &[]).unwrap();
}

/// Names that set a terminal's title, clear it, or hide a line.
#[test]
fn names_do_not_steer_the_terminal() {
    let scratch = Scratch::new("escapes");
    let hostile = "\u{1b}]0;title\u{7}\u{9b}2J\n-seed0";
    scratch.run_without_checksums("equi-seed0", alone(Method::Equi, 0));
    let run = scratch.0.join(hostile);
    fs::rename(scratch.0.join("equi-seed0"), &run).unwrap();
    for name in ["metrics.csv", "evaluation.csv"] {
        let text = fs::read_to_string(run.join(name)).unwrap();
        let text = text.replace("goal-reach", "\"goal\u{1b}[2J\u{202e}\n\"");
        fs::write(run.join(name), text).unwrap();
    }
    let out = scratch.0.join("out");
    let text = scratch.report(&[hostile], &["--out", out.to_str().unwrap()]).unwrap();
    assert!(text.contains("| goal\\u001b[2J\\u202e\\u000a |"), "{text}");
    let files = fs::read_dir(&out).unwrap().map(|file| file.unwrap().path());
    let files = files.map(|file| {
        assert_eq!(steering(&file.to_string_lossy()), None, "{}", file.display());
        fs::read_to_string(file).unwrap()
    });
    let mut watched = Vec::new();
    WatchOptions { run_folder: run, json: false }.print_events(&mut watched).unwrap();
    let watched = String::from_utf8(watched).unwrap();
    assert!(watched.contains("goal\\u001b[2J"), "{watched}");
    let refused = printable_message(&scratch.report(&["no\u{1b}run"], &[]).unwrap_err());
    for shown in files.chain([text, watched, refused]) {
        assert_eq!(steering(&shown), None, "{shown}");
    }
}

/// The first character that a terminal would obey; line ends are none.
fn steering(text: &str) -> Option<char> {
    let text = text.replace("\r\n", "\n");
    let mut signs = text.chars();
    signs.find(|&sign| (sign.is_control() && !matches!(sign, '\n' | '\t')) || sign == '\u{202e}')
}

#[test]
fn tables_that_changed_after_the_end_are_refused() {
    let scratch = Scratch::new("changed");
    scratch.run("cnn-seed0", alone(Method::Cnn, 0));
    scratch.report(&["cnn-seed0"], &[]).unwrap();
    for (name, column, plausible) in [
        ("metrics.csv", "reward", "300.5"),
        ("evaluation.csv", "success", "1"),
        ("timings.csv", "total", "0.5"),
    ] {
        let file = scratch.0.join("cnn-seed0").join(name);
        let table = fs::read_to_string(&file).unwrap();
        for changed in [with_cell(&table, column, plausible), table[..table.len() - 7].to_owned()] {
            fs::write(&file, changed).unwrap();
            let refusal = scratch.refusal(&["cnn-seed0"]);
            assert!(refusal.contains(name) && refusal.contains("was changed"), "{refusal}");
        }
        fs::write(&file, table).unwrap();
    }
}

/// A table with another cell in its last row.
fn with_cell(table: &str, column: &str, cell: &str) -> String {
    let names = table.lines().next().unwrap();
    let place = names.split(',').position(|name| name == column).unwrap();
    let last = table.lines().last().unwrap();
    let mut cells: Vec<&str> = last.split(',').collect();
    cells[place] = cell;
    table.replace(last, &cells.join(","))
}

#[test]
fn films_are_inside_of_the_page_where_they_are_asked_for() {
    let scratch = Scratch::new("films");
    let mut scored_once = small(Method::Equi, 0);
    scored_once.evaluation.visit_episodes_per_env = 0;
    scratch.run("equi-seed0", scored_once);
    let folder = scratch.0.join("report");
    let html = |more: &[&str]| {
        let out = ["--out", folder.to_str().unwrap()];
        let text = scratch.report(&["equi-seed0"], &[&out, more].concat()).unwrap();
        (text, fs::read_to_string(folder.join("report.html")).unwrap())
    };
    // of an earlier report
    fs::create_dir_all(&folder).unwrap();
    let stale = ["recognition.csv", "recognition.tex", "covers-seed7.svg", "learning-other.svg"];
    let stale = stale.map(|own| folder.join(own));
    let unrelated = folder.join("seeds.svg");
    fs::write(&unrelated, "another program's").unwrap();
    stale.iter().for_each(|file| fs::write(file, "stale").unwrap());
    let gifs = |page: &str| page.matches("src=\"data:image/gif;base64,R0lGODlh").count();
    let (text, page) = html(&[]);
    assert!(gifs(&page) == 0 && !text.contains(" films, "));
    assert!(!text.contains("after each of its visits"), "{text}");
    assert!(stale.iter().all(|file| !file.exists()) && folder.join("equi-seed0.svg").exists());
    assert!(unrelated.exists());
    // the one run of a page is not folded away
    assert_eq!(page.matches("<details").count(), 1);
    assert_eq!(page.matches("<details open>").count(), 1);
    assert!(!page.contains("Each seed"), "there is no curve");
    let (with_films, film_page) = html(&["--films"]);
    // the first one is on the first screen, too
    assert_eq!((gifs(&film_page), film_page.matches("src=").count()), (3, 3));
    assert!(with_films.contains("\nequi-seed0: 2 films, "), "{with_films}");
    fs::remove_dir_all(scratch.0.join("equi-seed0/checkpoints")).unwrap();
    let (without, bare_page) = html(&["--films"]);
    assert!(without.contains("\nequi-seed0: no films"), "{without}");
    assert_eq!(gifs(&bare_page), 0);
}

#[test]
fn the_papers_row_follows_the_settings_and_not_the_name() {
    let scratch = Scratch::new("names");
    let paper = |text: &str| {
        let rows = text.lines().filter(|line| line.contains("in the paper ("));
        rows.map(|row| row.split(" in ").next().unwrap().to_owned()).collect::<Vec<_>>()
    };
    scratch.run("covers-seed0", small(Method::Equi, 0));
    let text = scratch.report(&["covers-seed0"], &[]).unwrap();
    assert_eq!(paper(&text), ["| equi"]);
    let remark = "the settings are those of the preset `equi`, not of `covers`";
    assert!(text.contains(remark), "{text}");
    let rows = Rows::of(&text);
    // results, figures over seeds, visits, efficiency, variants, and the run itself; with one
    // policy for everything there is no recognition
    let tables = [
        (vec!["covers (1)"], 6),
        (vec!["covers (1)"], 17),
        (vec!["covers (1)"], 3),
        (vec!["goal-reach", "covers (1)"], 12),
        (vec!["covers (1)", "goal-reach"], 6),
        (vec!["covers-seed0 (1)"], 9),
    ];
    for (first, columns) in &tables {
        rows.find(first, *columns);
    }
    let mut own = small(Method::Equi, 0);
    own.envs.camera.size = 32;
    scratch.run("equi-seed0", own);
    let own_text = scratch.report(&["equi-seed0"], &[]).unwrap();
    assert!(paper(&own_text).is_empty(), "{own_text}");
    assert!(own_text.contains("`envs.camera.size` 48 and 32"), "{own_text}");
    let both = ["covers-seed0", "equi-seed0"];
    let both_text = scratch.report(&both, &[]).unwrap();
    assert!(both_text.contains("covers (2) against the other methods"), "{both_text}");
    Rows::of(&both_text).find(&["equi (3)"], 8);
}

#[test]
fn runs_that_do_not_compare_are_refused() {
    let scratch = Scratch::new("mixed");
    scratch.run("equi-seed0", alone(Method::Equi, 0));
    scratch.run("equi-seed1", alone(Method::Cnn, 1));
    let mut other = alone(Method::Cnn, 0);
    other.schedule.cycles = 2;
    scratch.run("cnn-seed0", other);
    let refusal = scratch.refusal(&["equi-seed0", "equi-seed1"]);
    assert!(refusal.contains("learner.covers.network.group"), "{refusal}");
    assert!(refusal.contains("rename its folder"), "{refusal}");
    let other_schedule = scratch.refusal(&["equi-seed0", "cnn-seed0"]);
    assert!(other_schedule.contains("`schedule.cycles` 1 and 2"), "{other_schedule}");
    assert!(other_schedule.contains("leave it out"), "{other_schedule}");
    fs::create_dir(scratch.0.join("copy")).unwrap();
    let copied = Path::new("copy").join("equi-seed0");
    fs::rename(scratch.0.join("equi-seed1"), scratch.0.join("moved")).unwrap();
    scratch.run("copy/equi-seed0", alone(Method::Equi, 0));
    let same_seed = scratch.refusal(&["equi-seed0", copied.to_str().unwrap()]);
    assert!(same_seed.contains("two runs have seed 0"), "{same_seed}");
    assert!(same_seed.contains("leave one of the two out"), "{same_seed}");
}
