//! The networks and the update embed in a program that has neither MuJoCo nor a command line: a
//! crate outside this repository depends on `covers-rl` and `covers-equivariant` by path. The
//! learner embeds without a screen. What such a crate would compile is looked at here; that every
//! package compiles by itself is seen where
//! `make test` packages them.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

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

/// What cargo prints for these arguments in this folder, without network.
fn cargo(folder: &Path, arguments: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO"));
    command.current_dir(folder).args(arguments).arg("--offline");
    let output = command.output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo {arguments:?}: {message}");
    String::from_utf8(output.stdout).unwrap()
}

/// A crate in a temporary folder, gone when the test ends.
struct Stranger(PathBuf);

impl Stranger {
    /// Depends on these folders of the repository, and on the versions that its lock file names.
    fn new(dependencies: &[(&str, &str)]) -> Self {
        let lines = dependencies.iter();
        let lines: String = lines
            .map(|(package, folder)| format!("{package} = {{ path = \"{ROOT}/{folder}\" }}\n"))
            .collect();
        Self::with(dependencies[0].1, &lines)
    }

    /// Has these lines of dependencies, and a folder of this name.
    fn with(name: &str, lines: &str) -> Self {
        let name = format!("covers-stranger-{name}-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        let head = "[package]\nname = \"stranger\"\nedition = \"2024\"\n\n[dependencies]\n";
        let manifest = format!("{head}{lines}");
        fs::create_dir_all(folder.join("src")).unwrap();
        fs::write(folder.join("Cargo.toml"), manifest).unwrap();
        fs::write(folder.join("src/main.rs"), "fn main() {}\n").unwrap();
        fs::copy(Path::new(ROOT).join("Cargo.lock"), folder.join("Cargo.lock")).unwrap();
        Self(folder)
    }

    /// Unwanted crates among all that a build compiles.
    fn unwanted(&self) -> Vec<String> {
        let edges = ["--edges", "normal,build", "--prefix", "none"];
        let tree = cargo(&self.0, &[&["tree"][..], &edges].concat());
        let mut names: Vec<String> = tree.lines().filter_map(first_word).collect();
        assert!(names.iter().any(|name| name == "covers-symmetry"), "{tree}");
        names.sort_unstable();
        names.dedup();
        names.retain(|name| UNWANTED.contains(&&name[..]));
        names
    }
}

impl Drop for Stranger {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn first_word(line: &str) -> Option<String> {
    line.split_whitespace().next().map(str::to_owned)
}

#[test]
fn networks_and_update_need_neither_simulator_nor_command_line() {
    let crates = [("covers-rl", "rl"), ("covers-equivariant", "equivariant")];
    let stranger = Stranger::new(&crates);
    assert_eq!(stranger.unwanted(), [""; 0]);
}

#[test]
fn the_environments_bring_the_simulator() {
    let stranger = Stranger::new(&[("covers-envs", "envs")]);
    let unwanted = stranger.unwanted();
    for expected in ["bindgen", "covers-envs", "covers-mujoco", "covers-mujoco-sys"] {
        assert!(unwanted.iter().any(|name| name == expected), "{expected}: {unwanted:?}");
    }
}

#[test]
fn the_learner_embeds_without_a_screen() {
    for (features, expected) in [("", true), (", default-features = false", false)] {
        let lines =
            format!("covers = {{ package = \"covers-rs\", path = \"{ROOT}\"{features} }}\n");
        let stranger = Stranger::with(&format!("learner-{expected}"), &lines);
        let screen = stranger.unwanted().iter().any(|name| name == "ratatui");
        assert_eq!(screen, expected, "{features}");
    }
}
