//! Fuzz target of the run's state, which a checkpoint holds beside the learner.

use std::path::PathBuf;
use std::sync::LazyLock;

use covers::presets::{Budget, Method};
use covers::{RunFolder, RunStats};
use serde_json::{Value, json};

use super::tensors::sealed;
use super::{Reading, Target, accepted, measured, own_path};

pub const NOTE: Target = Target::new("note", read, notes).holding(64, 1 << 13).tried(5_000);

/// Folder of a run that has lost its settings, and the folder of its checkpoint.
static RUN: LazyLock<(PathBuf, PathBuf)> = LazyLock::new(|| {
    let run = own_path("note");
    let checkpoints = run.join("checkpoints");
    let made = std::fs::create_dir_all(&checkpoints);
    made.unwrap_or_else(|error| panic!("{}: {error}", checkpoints.display()));
    (run, checkpoints)
});

/// Reads the settings from the run's state in the only checkpoint.
fn read(input: &[u8]) -> Option<Reading> {
    let (run, checkpoints) = &*RUN;
    // a checkpoint's file name must agree with its number of rollouts
    let note: Option<Value> = serde_json::from_slice(input).ok();
    let rollouts = note.and_then(|note| note.pointer("/note/ledger/rollouts")?.as_u64());
    let checkpoint = checkpoints.join(format!("{:06}.safetensors", rollouts.unwrap_or(1)));
    let end = 4 + input.len();
    let arrays = json!({
        "checksum": {"dtype": "U8", "shape": [4], "data_offsets": [0, 4]},
        "note": {"dtype": "U8", "shape": [input.len()], "data_offsets": [4, end]},
    });
    let envelope = json!({ "format": 5, "header": {} }).to_string();
    let file = sealed(&envelope, &arrays.to_string(), &[&[0; 4], input].concat())?;
    let named = |error| panic!("{}: {error}", checkpoint.display());
    std::fs::write(&checkpoint, file).unwrap_or_else(named);
    let reading = measured(|| accepted(RunFolder::from_path(run).read_experiment()));
    std::fs::remove_file(&checkpoint).unwrap_or_else(named);
    reading
}

fn notes() -> Vec<Vec<u8>> {
    let ledger = RunStats {
        created_for_group: vec![Some("goal-reach".to_owned()), None],
        rollouts: 2,
        decisions: 240,
        switch_rollouts: 1,
        correct_assignments: 1,
        ..RunStats::default()
    };
    let metrics = "rollout,group\n0,goal-reach\n1,goal-reach\n";
    let begun = note(Method::Covers, &RunStats::default(), 1, "", "");
    let others = [Method::CoversGt, Method::Equi, Method::ThreeRl, Method::EquiSac];
    let others = others.map(|method| note(method, &ledger, 0, metrics, "rollouts,group\n"));
    let notes = [begun].into_iter().chain(others);
    notes.map(|note| note.to_string().into_bytes()).collect()
}

fn note(method: Method, ledger: &RunStats, due: usize, metrics: &str, scores: &str) -> Value {
    json!({
        "experiment": Budget::Smoke.preset_experiment(method),
        "note": {
            "ledger": ledger,
            "due": due,
            "rows": {"metrics": metrics, "scores": scores},
        },
    })
}
