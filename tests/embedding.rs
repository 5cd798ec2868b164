//! The networks and the update embed in a program that has neither MuJoCo nor a command line, and
//! the learner embeds without a screen. What a crate would compile that depends on these packages
//! is looked at here; that every package compiles by itself is seen where `make test` packages
//! them.

use std::collections::BTreeSet;

use crate::dependencies::compiled;

/// Crates that only simulation, pictures and the command line need.
const UNWANTED: [&str; 8] = [
    "covers-mujoco",
    "covers-mujoco-sys",
    "covers-envs",
    "bindgen",
    "clap",
    "png",
    "ratatui",
    "zip",
];

/// Unwanted crates among all that a build of these packages compiles.
fn unwanted(packages: &[&str]) -> Vec<&'static str> {
    let crates = compiled(packages);
    let names: BTreeSet<&str> = crates.iter().map(|(name, _)| &name[..]).collect();
    assert!(names.contains("covers-symmetry"), "{names:?}");
    UNWANTED.into_iter().filter(|name| names.contains(*name)).collect()
}

#[test]
fn networks_and_update_need_neither_simulator_nor_command_line() {
    let packages = ["--package", "covers-rl", "--package", "covers-equivariant"];
    assert_eq!(unwanted(&packages), [""; 0]);
}

#[test]
fn the_environments_bring_the_simulator() {
    let found = unwanted(&["--package", "covers-envs"]);
    for expected in ["bindgen", "covers-envs", "covers-mujoco", "covers-mujoco-sys"] {
        assert!(found.contains(&expected), "{expected}: {found:?}");
    }
}

#[test]
fn the_learner_embeds_without_a_screen() {
    let screen = |features: &[&str]| {
        unwanted(&[&["--package", "covers-rs"], features].concat()).contains(&"ratatui")
    };
    assert!(screen(&[]));
    assert!(!screen(&["--no-default-features"]));
}
