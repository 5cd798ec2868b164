//! The tables of docs/ppo.md against the code: every value is the preset's, every name is in the
//! file it is said to be in.

use covers::CoversSettings;
use rl::Metrics;
use serde_json::Value;

const PAGE: &str = include_str!("../docs/ppo.md");

/// Cells of all table rows that are neither heads nor rules.
fn rows() -> Vec<Vec<&'static str>> {
    let lines = PAGE.lines().filter(|line| line.starts_with("| "));
    let cells = lines.map(|line| {
        let mut cells: Vec<&str> = line.split(" |").map(str::trim).collect();
        cells[0] = cells[0].trim_start_matches("| ");
        cells.pop();
        cells
    });
    cells.filter(|cells| !["Detail", "Column"].contains(&cells[0])).collect()
}

/// The pieces of a text between back-ticks.
fn names(text: &str) -> Vec<&str> {
    text.split('`').skip(1).step_by(2).collect()
}

fn has_word(text: &str, word: &str) -> bool {
    text.split(|c: char| !c.is_alphanumeric() && c != '_').any(|other| other == word)
}

/// Names of a "`name` in [file](../file)" cell that the file lacks.
fn missing(cell: &str) -> Vec<String> {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut missing = Vec::new();
    for part in cell.split("; ") {
        let (listed, link) = part.split_once(" in ").unwrap();
        let file = link.split(['(', ')']).nth(1).unwrap().trim_start_matches("../");
        let text = std::fs::read_to_string(root.join(file)).unwrap();
        assert!(!names(listed).is_empty(), "{part}");
        let absent = names(listed).into_iter().filter(|name| !has_word(&text, name));
        missing.extend(absent.map(|name| format!("{name} in {file}")));
    }
    missing
}

#[test]
fn every_name_is_in_the_file_that_is_linked() {
    let rows = rows();
    assert!(rows.len() > 40, "{}", rows.len());
    for cells in rows {
        assert_eq!(missing(cells.last().unwrap()), [""; 0], "{cells:?}");
    }
    let wrong = "`gae`, `gea` in [rl/src/gae.rs](../rl/src/gae.rs)";
    assert_eq!(missing(wrong), ["gea in rl/src/gae.rs"]);
}

/// A setting of the learner, its update or its network, as a file would hold it.
fn setting(settings: &CoversSettings, name: &str) -> Value {
    let text = serde_json::to_string(settings).unwrap();
    let all: Value = serde_json::from_str(&text).unwrap();
    let places = [&all["ppo"], &all["network"], &all];
    let found = places.into_iter().find_map(|place| place.get(name));
    found.unwrap_or_else(|| panic!("no setting `{name}`")).clone()
}

/// Whether a cell states the value: a number, or the name of a variant in words.
fn states(cell: &str, value: &Value) -> bool {
    let variant = value.as_object().and_then(|fields| fields.keys().next().map(String::as_str));
    match (cell.parse::<f64>(), value.as_f64()) {
        (Ok(stated), Some(value)) => stated == value,
        _ if value.is_null() => cell == "none",
        _ if value.is_boolean() => cell.parse() == Ok(value == &Value::Bool(true)),
        _ => value.as_str().or(variant) == Some(cell.replace(' ', "_").as_str()),
    }
}

#[test]
fn every_value_is_that_of_the_presets() {
    let mut seen = 0;
    for cells in rows().into_iter().filter(|cells| cells.len() == 6) {
        for name in names(cells[1]) {
            for (cell, preset) in
                [(cells[2], CoversSettings::default()), (cells[3], CoversSettings::paper())]
            {
                let value = setting(&preset, name);
                assert!(states(cell, &value), "{name}: {cell} is not {value}");
            }
            seen += 1;
        }
    }
    assert_eq!(seen, 23);
    assert!(!states("0.3", &setting(&CoversSettings::default(), "clip")));
    assert!(!states("reuse", &setting(&CoversSettings::default(), "handover")));
}

#[test]
fn every_setting_of_the_update_is_in_a_table() {
    let listed: Vec<&str> = rows().iter().flat_map(|cells| names(cells[1])).collect();
    let all = serde_json::to_value(rl::PpoSettings::default()).unwrap();
    for name in all.as_object().unwrap().keys() {
        assert!(listed.contains(&name.as_str()), "{name}");
    }
}

#[test]
fn every_logged_column_is_written_and_every_metric_is_in_the_table() {
    let update =
        rl::PpoStats { log_std: vec![0.0], symmetry_loss: Some(0.0), ..rl::PpoStats::default() };
    let metrics: Vec<String> = update.metrics().into_iter().map(|(name, _)| name).collect();
    let writer = include_str!("../experiments/src/logs.rs");
    let columns = rows().into_iter().filter(|cells| cells.len() == 4);
    let columns: Vec<&str> = columns.map(|cells| names(cells[0])[0]).collect();
    for column in &columns {
        let written = writer.contains(&format!("\"{column}\""));
        assert!(written || metrics.iter().any(|m| m == column), "{column}");
    }
    for metric in metrics {
        assert!(columns.contains(&&metric[..]), "{metric}");
    }
}
