//! Help of a call without a command, and the end of commands whose output nobody reads.

use std::io::pipe;
use std::process::Command;

use clap::Parser;
use covers::program::CoversCli;

use crate::common::covers;

/// Without a command the whole help is printed, however long it is.
#[test]
fn help_is_never_cut() {
    for arguments in [&[][..], &["model"]] {
        let output = Command::new(env!("CARGO_BIN_EXE_covers")).args(arguments).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(said.contains("Commands:") && said.contains("Example"), "{said}");
        assert!(!said.contains("left out"), "{said}");
        assert_eq!(output.status.code(), Some(2));
    }
}

#[test]
fn mistakes_of_newcomers_are_answered_with_what_to_do() {
    // clap does not check what an option requires beside another one that excludes that
    for line in [
        "covers train --runs elsewhere --overwrite",
        "covers report run --tensorboard boards --films",
    ] {
        assert!(CoversCli::try_parse_from(line.split(' ')).is_err(), "{line}");
    }
    let seed = CoversCli::try_parse_from(["covers", "train", "--seed", "-1"]).unwrap_err();
    assert!(seed.to_string().contains("invalid value '-1' for '--seed"), "{seed}");
    let no_runs = covers(&["list", "nowhere"]).unwrap_err().to_string();
    assert!(no_runs.contains("Start one with `covers train`"), "{no_runs}");
}

/// As after `covers presets | head -1`.
#[test]
fn commands_end_quietly_when_their_reader_is_gone() {
    let run = "assets/pretrained";
    let commands: [&[&str]; 8] = [
        &["presets"],
        &["presets", "covers-sac", "--explain"],
        &["presets", "--schema"],
        &["completions", "bash"],
        &["man"],
        &["list", run],
        &["robot", "check", "assets/urdf/kinova_gen3.urdf"],
        &["sweep", "docs/results/plans/table-sac.json", "--slurm"],
    ];
    for arguments in commands {
        let (reader, writer) = pipe().unwrap();
        drop(reader);
        let mut command = Command::new(env!("CARGO_BIN_EXE_covers"));
        command.args(arguments).current_dir(env!("CARGO_MANIFEST_DIR")).stdout(writer);
        let output = command.output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!((output.status.code(), said.as_str()), (Some(141), ""), "{arguments:?}");
    }
}
