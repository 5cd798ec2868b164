//! Contents of screens of several sizes.

use std::collections::HashSet;
use std::time::Duration;

use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;
use ratatui::style::Color;
use symmetry::D2;

use super::draw::{ScreenContents, draw_run_screen};
use experiments::colours::curve_rgb;
use experiments::presets::{Budget, Method};
use experiments::sheet::Picture;
use experiments::{RolloutRow, RunData, ScoreRow, TimingRow};

const WIDE: (u16, u16) = (160, 50);
const NARROW: (u16, u16) = (40, 12);

/// Run that visits two groups with rising rewards; the second rollout of the second group is
/// assigned to the policy of the first group.
fn run() -> RunData {
    // the paper's settings, which have a threshold
    let mut run = RunData::empty("covers-seed0", Budget::Smoke.preset_experiment(Method::Paper));
    let stream = run.experiment.schedule.total_decisions();
    let groups = [0, 1].map(|number: usize| run.experiment.schedule.groups[number].group.clone());
    for (turn, (group, policy)) in
        [(0, 0), (0, 0), (0, 0), (1, 1), (1, 0), (1, 1)].into_iter().enumerate()
    {
        run.rollouts.push(RolloutRow {
            decisions: (turn + 1) * stream / 8,
            group: groups[group].clone(),
            last_group: groups[group].clone(),
            policy,
            created_policy: turn == 0 || turn == 3,
            reward: Some(100.0 + 60.0 * turn as f64),
            success: Some(turn as f64 / 5.0),
            distances: vec![Some(1.5), Some(f64::NAN)],
            ..RolloutRow::default()
        });
        run.timings.push(TimingRow { decisions: stream / 8, total: 10.0, ..TimingRow::default() });
    }
    run.scores = D2::ALL.map(|element| score(&groups[0], element)).to_vec();
    run
}

fn score(group: &str, element: D2) -> ScoreRow {
    ScoreRow {
        rollouts: 3,
        group: group.to_owned(),
        element: element.to_string(),
        success: 0.25,
        ..ScoreRow::default()
    }
}

fn red() -> Picture {
    Picture { width: 2, height: 2, rgb: [[200, 0, 0]; 4].concat() }
}

fn drawn(run: &RunData, size: (u16, u16)) -> Buffer {
    let shown = ScreenContents {
        run,
        finished: false,
        time_since_change: Some(Duration::from_secs(70)),
        picture: Some(("how it begins".to_owned(), red())),
        key_help: "q quits",
        explained: false,
    };
    let mut terminal = Terminal::new(TestBackend::new(size.0, size.1)).unwrap();
    terminal.draw(|frame| draw_run_screen(&shown, frame)).unwrap();
    terminal.backend().buffer().clone()
}

fn lines(buffer: &Buffer) -> Vec<String> {
    let area = buffer.area;
    let line = |y| (0..area.width).map(|x| buffer[(x, y)].symbol()).collect();
    (0..area.height).map(line).collect()
}

fn colour(number: usize) -> Color {
    let [r, g, b] = curve_rgb(number);
    Color::Rgb(r, g, b)
}

/// Returns the column and row of the first character behind the name of a strip.
fn strip(buffer: &Buffer, name: &str) -> (u16, u16) {
    let lines = lines(buffer);
    let found = lines.iter().enumerate().find_map(|(y, line)| {
        let x = line.trim_start_matches('│').starts_with(&format!("{name:<7}"));
        x.then_some(y as u16)
    });
    let y = found.unwrap_or_else(|| panic!("{name}: {lines:#?}"));
    let border = u16::from(lines[usize::from(y)].starts_with('│'));
    (border + 7, y)
}

/// Returns the words behind a name, in the first line that has it.
fn words_behind<'a>(name: &str, text: &'a str) -> Vec<&'a str> {
    let (_, behind) = text.lines().find_map(|line| line.split_once(name)).unwrap();
    behind.split_whitespace().collect()
}

/// Returns a group as its table shows it, behind its first letter.
fn lettered(group: &str) -> String {
    format!("{} {group}", &group[..1])
}

#[test]
fn a_wide_screen_shows_everything() {
    let run = run();
    let text = lines(&drawn(&run, WIDE)).join("\n");
    let plans = &run.experiment.schedule.groups;
    for expected in [
        "covers-seed0",
        "policy 1",
        "75 %, ",
        "decisions/s",
        "reward of 500",
        "success",
        "threshold",
        "W1 / threshold",
        "how it begins",
        "q quits  ? explains  newest row 1 min old",
        &lettered(&plans[0].group),
        &lettered(&plans[1].group),
    ] {
        assert!(text.contains(expected), "{expected}: {text}");
    }
    let row = |name: &str| {
        let row = text.lines().find(|line| line.contains(name)).unwrap();
        row.split_whitespace().map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(row(&lettered(&plans[0].group))[2..7], ["3", "0", "220.0", "0.40", "0.25"]);
    // a group that has not come
    assert_eq!(row(&lettered(&plans[2].group))[2..7], ["0", "-", "-", "-", "-"]);
    // the distance, its threshold, and a bar where there is a ratio
    assert_eq!(words_behind("│policy 0  ", &text)[..2], ["1.50", "1.00"]);
    assert_eq!(words_behind("│policy 1  ", &text)[..3], ["-", "1.00", "-"]);
}

#[test]
fn no_label_is_cut_on_small_terminals() {
    for size in [(80, 24), (100, 30)] {
        let text = lines(&drawn(&run(), size)).join("\n");
        for label in [
            "│group          rollouts policy reward success scored│",
            "W1 of rollout 5",
            "W1    limit",
            "│policy 1  ",
            "group that ran and policy that was assigned, whole stream",
            "b button-press ",
            "reward of 500",
        ] {
            assert!(text.contains(label), "{label}: {text}");
        }
    }
}

#[test]
fn strips_hold_the_whole_stream() {
    let mut long = run();
    let rows = long.rollouts.clone();
    long.rollouts = rows.iter().flat_map(|row| vec![row.clone(); 100]).collect();
    let buffer = drawn(&long, (80, 24));
    let (left, y) = strip(&buffer, "policy");
    let right = (left..80).take_while(|&x| buffer[(x, y)].symbol() != "│").last().unwrap();
    let digit = |x: u16| buffer[(x, y)].symbol();
    assert_eq!((digit(left), digit(right)), ("0", "1"));
    let digits: String = (left..=right).map(digit).collect();
    assert_eq!(digits.trim_matches('0').matches("10").count(), 1, "{digits}");
}

#[test]
fn the_help_explains_the_screen() {
    let run = run();
    let shown = ScreenContents {
        run: &run,
        finished: false,
        time_since_change: None,
        picture: None,
        key_help: "q quits",
        explained: true,
    };
    let mut terminal = Terminal::new(TestBackend::new(80, 24)).unwrap();
    terminal.draw(|frame| draw_run_screen(&shown, frame)).unwrap();
    let text = lines(terminal.backend().buffer()).join("\n");
    assert!(text.contains("│two colours in a column: the policy of another group  │"), "{text}");
}

#[test]
fn of_many_groups_those_that_ran_last_are_shown() {
    let experiment = Budget::All.preset_experiment(Method::CoversSac);
    let mut run = RunData::empty("covers-sac-seed0", experiment);
    let groups: Vec<_> = run.experiment.schedule.groups.iter().map(|p| p.group.clone()).collect();
    for (policy, group) in groups.iter().enumerate() {
        run.rollouts.push(RolloutRow {
            decisions: 500 * (policy + 1),
            group: group.clone(),
            last_group: group.clone(),
            policy,
            distances: vec![Some(1.5); policy + 1],
            ..RolloutRow::default()
        });
    }
    for size in [(80, 24), (100, 30)] {
        let buffer = drawn(&run, size);
        let text = lines(&buffer).join("\n");
        assert!(text.contains("of 14 groups") && text.contains("policy 0"), "{text}");
        // behind its letter in the table: the title of the screen names it, too
        let row = |line: &str| {
            let before = line.split_once(&groups[13]).map(|(before, _)| before.chars().rev());
            let before = before.map(|before| before.take(3).collect::<Vec<_>>());
            matches!(before.as_deref(), Some([' ', 'a'..='z', '│']))
        };
        assert!(text.lines().any(row), "{text}");
        let (left, y) = strip(&buffer, "policy");
        let digits: String = (0..14).map(|x| buffer[(left + x, y)].symbol()).collect();
        assert_eq!(digits, "0123456789abcd");
        let letters: HashSet<&str> = (0..14).map(|x| buffer[(left + x, y - 1)].symbol()).collect();
        assert_eq!(letters.len(), 14, "{letters:?}");
    }
}

#[test]
fn distances_without_a_threshold_stand_alone() {
    let mut run = run();
    run.experiment = Budget::Smoke.preset_experiment(Method::Covers);
    let text = lines(&drawn(&run, WIDE)).join("\n");
    assert!(text.contains("W1 of rollout 5") && !text.contains("threshold"), "{text}");
    let policy = text.lines().find(|line| line.contains("│policy 0  ")).unwrap();
    let (_, after) = policy.split_once("│policy 0  ").unwrap();
    let (panel, _) = after.split_once('│').unwrap();
    assert_eq!(panel.trim_end(), "1.50");
}

#[test]
fn strips_have_the_colours_of_reports_on_every_screen() {
    let run = run();
    for size in [WIDE, NARROW, (80, 24), (120, 28)] {
        let buffer = drawn(&run, size);
        let colours = |name: &str| {
            let (left, y) = strip(&buffer, name);
            (0..6).map(|x| buffer[(left + x, y)].bg).collect::<Vec<_>>()
        };
        let of = |numbers: [usize; 6]| numbers.map(colour).to_vec();
        assert_eq!(colours("group"), of([0, 0, 0, 1, 1, 1]), "{size:?}");
        // the fifth was wrong
        assert_eq!(colours("policy"), of([0, 0, 0, 1, 0, 1]), "{size:?}");
        let (left, y) = strip(&buffer, "policy");
        let digits: String = (0..6).map(|x| buffer[(left + x, y)].symbol()).collect();
        assert_eq!(digits, "000101");
    }
}

/// Returns the columns and rows of cells with a curve in a group's colour.
fn points(buffer: &Buffer, number: usize) -> Vec<(u16, u16)> {
    let area = buffer.area;
    let all = (0..area.width).flat_map(|x| (0..area.height).map(move |y| (x, y)));
    let is_braille =
        |symbol: &str| symbol.chars().all(|dots| ('\u{2801}'..='\u{28ff}').contains(&dots));
    all.filter(|&at| buffer[at].fg == colour(number) && is_braille(buffer[at].symbol())).collect()
}

#[test]
fn a_curve_rises_where_the_data_rises() {
    let run = run();
    for size in [NARROW, (60, 24)] {
        let buffer = drawn(&run, size);
        let mut both = points(&buffer, 0);
        both.extend(points(&buffer, 1));
        let first = both.iter().min_by_key(|(x, _)| x).unwrap();
        let last = both.iter().max_by_key(|(x, _)| x).unwrap();
        // rows are counted from above
        assert!(last.1 < first.1, "{size:?}: {both:?}");
        assert!(points(&buffer, 0).iter().max() < points(&buffer, 1).iter().min());
    }
}

#[test]
fn a_picture_has_its_own_colours() {
    let buffer = drawn(&run(), WIDE);
    let red = buffer.content.iter().filter(|cell| cell.fg == Color::Rgb(200, 0, 0));
    let red: Vec<_> = red.collect();
    assert!(red.len() > 100, "{}", red.len());
    assert!(red.iter().all(|cell| cell.symbol() == "▀" && cell.bg == cell.fg));
}

#[test]
fn a_run_without_rows_and_screens_of_any_size_are_drawn() {
    let empty = RunData::empty("covers-seed0", Budget::Smoke.preset_experiment(Method::Covers));
    let text = lines(&drawn(&empty, WIDE)).join("\n");
    for expected in ["begins", "0 %, - left, - decisions/s", "no rollout yet"] {
        assert!(text.contains(expected), "{expected}: {text}");
    }
    let mut undefined = run();
    for row in &mut undefined.rollouts {
        (row.reward, row.success) = (Some(f64::NAN), None);
        row.distances = vec![None, Some(f64::INFINITY)];
        row.group = "a group of nobody's".to_owned();
    }
    for run in [&empty, &run(), &undefined] {
        for width in [1, 2, 7, 8, 40, 99, 100, 300] {
            for height in [1, 2, 3, 5, 12, 20, 30, 90] {
                drawn(run, (width, height));
            }
        }
    }
}
