//! Fuzz targets of text that users write: field types, settings, command lines.

use std::cell::RefCell;
use std::ffi::OsString;
use std::os::unix::ffi::OsStrExt;
use std::path::{Component, Path};
use std::sync::LazyLock;

use allocation_counter::opt_out;
use clap::{CommandFactory, FromArgMatches, Subcommand};
use covers::check::CheckCommand;
use covers::cli::{ContinualStreamExampleOptions, TrainOptions};
use covers::commands::TrainingRunCommand;
use covers::presets::{Budget, Method};
use covers::{Experiment, LearnerSettings, SettingOverride};
use envs::{Embodiment, TaskRegistry};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::NetworkSettings;
use symmetry::{FieldType, Group};

use super::small::{is_small, small_network};
use super::{Reading, Target, accepted, measured, texts};

pub const NOTATION: Target =
    Target::new("notation", read_notation, notations).holding(8, 1 << 9).tried(20_000);

pub const SETTINGS: Target =
    Target::new("settings", read_settings, settings).holding(32, 1 << 12).tried(2_000);

pub const COMMAND_LINE: Target =
    Target::new("command-line", read_command_line, command_lines).holding(64, 3 << 15).tried(2_000);

fn read_notation(input: &[u8]) -> Option<Reading> {
    let text = std::str::from_utf8(input).ok()?;
    measured(|| {
        let field = text.parse::<FieldType>();
        if let Ok(field) = field {
            assert_eq!(field.to_string().parse(), Ok(field), "{text:?}");
        }
        accepted(text.parse::<Group>()) | accepted(text.parse::<Embodiment>()) | accepted(field)
    })
}

fn notations() -> Vec<Vec<u8>> {
    texts([
        "8 reg + 2 x",
        "D1y: 3 1 + 4 y",
        "C2: 1 reg",
        "C1: 16777216 1",
        "D1x: 0",
        "2 xy",
        "hand",
    ])
}

fn read_settings(input: &[u8]) -> Option<Reading> {
    measured(|| {
        let text = std::str::from_utf8(input).unwrap_or_default();
        let experiment = Experiment::parse(text);
        if let Ok(experiment) = &experiment {
            opt_out(|| check(experiment));
        }
        accepted(experiment)
    })
}

/// Asserts that settings are either refused, or survive a round trip through text.
fn check(experiment: &Experiment) {
    if !is_small(experiment) || experiment.check(&TaskRegistry::with_all()).is_err() {
        return;
    }
    let text = serde_json::to_string(experiment).unwrap_or_default();
    let again = serde_json::from_str::<Experiment>(&text);
    assert_eq!(again.ok().as_ref(), Some(experiment), "{text}");
    let visits = experiment.schedule.draw_visits(1, &mut ChaCha8Rng::seed_from_u64(0));
    let decisions: usize = visits.iter().map(|visit| visit.decisions).sum();
    assert_eq!(decisions, experiment.schedule.total_decisions());
}

fn settings() -> Vec<Vec<u8>> {
    let experiments = Method::ALL.map(|method| {
        let mut experiment = Budget::Smoke.preset_experiment(method);
        let network = match &mut experiment.learner {
            LearnerSettings::Covers(settings) => &mut settings.network,
            LearnerSettings::OffPolicy(settings) => &mut settings.network,
        };
        *network = NetworkSettings { group: network.group, ..small_network() };
        experiment.envs.camera.size = 16;
        serde_json::to_vec(&experiment)
    });
    experiments.into_iter().flatten().collect()
}

pub const OVERRIDES: Target =
    Target::new("overrides", read_overrides, overrides).holding(256, 1 << 17).tried(500);

/// Reads overrides, one on each line, and applies them to a small experiment, whose JSON tree takes
/// the target's constant.
fn read_overrides(input: &[u8]) -> Option<Reading> {
    static EXPERIMENT: LazyLock<Experiment> = LazyLock::new(|| {
        let mut experiment = Budget::Smoke.preset_experiment(Method::Covers);
        experiment.schedule.groups.truncate(1);
        experiment
    });
    let text = std::str::from_utf8(input).ok()?;
    let experiment = EXPERIMENT.clone();
    measured(|| {
        let set: Result<Vec<SettingOverride>, _> = text.lines().map(str::parse).collect();
        accepted(set.and_then(|set| covers::apply_overrides(&set, experiment)))
    })
}

fn overrides() -> Vec<Vec<u8>> {
    texts([
        "covers.ppo.gamma=0.97",
        "gamma=0.97",
        "schedule.groups.0.variants=[\"flip x\"]\nschedule.cycles=2",
        "covers.grouping=oracle",
        "evaluation.every=null\n evaluation.rounds = 3",
        "schedule.groups.18446744073709551615.decisions=1",
    ])
}

thread_local! {
    static COMMANDS: RefCell<[clap::Command; 2]> = RefCell::new([
        TrainingRunCommand::augment_subcommands(clap::Command::new("covers"))
            .subcommand(CheckCommand::augment_subcommands(clap::Command::new("check"))),
        ContinualStreamExampleOptions::command(),
    ]);
}

/// Reads arguments, one on each line. Arguments of the example follow the line `stream`.
fn read_command_line(input: &[u8]) -> Option<Reading> {
    let lines = input.split(|&byte| byte == b'\n');
    let arguments = lines.map(|line| OsString::from(std::ffi::OsStr::from_bytes(line)));
    let arguments: Vec<OsString> =
        [OsString::from("covers")].into_iter().chain(arguments).collect();
    COMMANDS.with_borrow_mut(|[covers, stream]| {
        measured(|| {
            if arguments[1] == "stream" {
                reads_stream(stream, &arguments[1..])
            } else {
                reads_command(covers, &arguments)
            }
        })
    })
}

fn reads_stream(stream: &mut clap::Command, arguments: &[OsString]) -> bool {
    let matches = stream.try_get_matches_from_mut(arguments);
    if let Ok(matches) = &matches {
        assert!(ContinualStreamExampleOptions::from_arg_matches(matches).is_ok());
    }
    accepted(matches)
}

fn reads_command(covers: &mut clap::Command, arguments: &[OsString]) -> bool {
    let matches = covers.try_get_matches_from_mut(arguments);
    if let Ok(matches) = &matches {
        check_names(TrainingRunCommand::from_arg_matches(matches).ok());
    }
    accepted(matches)
}

/// Asserts that the folder of a run lies in the requested folder, for any name of the settings'
/// file.
fn check_names(command: Option<TrainingRunCommand>) {
    let Some(TrainingRunCommand::Train(options)) = command else {
        return;
    };
    let mut preset = TrainOptions { config: None, ..options.clone() };
    // the target OVERRIDES tests these
    preset.run_options.settings.set.overrides.clear();
    let Ok(experiment) = preset.experiment() else {
        return;
    };
    let name = options.run_name(&experiment);
    let parts: Vec<Component> = Path::new(&name).components().collect();
    assert!(matches!(parts[..], [Component::Normal(_)]), "{name:?}");
}

fn command_lines() -> Vec<Vec<u8>> {
    texts([
        "train\n--preset\nequi\n--budget\nsmoke\n--seed\n7\n--threads\n2\n--group\nC2\n--json",
        "train\n--set\ncovers.ppo.gamma=0.97\n--set\nschedule.groups.0.decisions=80",
        "train\n--folder\nx\n--overwrite",
        "sweep\nplan.json\n--job\n3",
        "train\n--config\n../a/b.json\n--runs\n/tmp/x\n--embodiment\nhand",
        "resume\nruns/a\n--threads=1\n--json",
        "eval\nruns/a\n--episodes\n20\n--embodiment\nsawyer",
        "pack\nruns/a\nb\n--episodes=8",
        "check\nexperts\n--embodiment\nhand\n--seeds\n3",
        "check\nsymmetry\n--embodiment\nhand",
        "check\nparity\nrecordings\n--json",
        "check\nmask\nruns/a\n--fault\nangle-error=3\n--calibration\nc.json",
        "stream\n--budget\nzero-shot\n--runs\nx",
        "help\ntrain",
    ])
}
