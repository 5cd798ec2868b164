//! The networks and the update embed in a program that has neither MuJoCo nor a command line: a
//! crate outside this repository depends on `covers-rl` and `covers-equivariant` by path.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// Crates that only simulation, pictures and the command line need.
const UNWANTED: [&str; 7] = [
    "covers-mujoco",
    "covers-mujoco-sys",
    "covers-envs",
    "bindgen",
    "clap",
    "png",
    "zip",
];

const PROGRAM: &str = r#"
fn main() {
    let fields = equivariant::Group::D2.regular(4);
    println!("{fields}, {:?}", rl::PpoSettings::default());
}
"#;

/// What cargo prints for these arguments in this folder, without network. It works in the folder of
/// this test, so that build scripts are there already.
fn cargo(folder: &Path, arguments: &[&str]) -> String {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap();
    let mut command = Command::new(env!("CARGO"));
    command.current_dir(folder).args(arguments).arg("--offline");
    command.env("CARGO_TARGET_DIR", target);
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
        let name = format!(
            "covers-stranger-{}-{}",
            dependencies[0].1,
            std::process::id()
        );
        let folder = std::env::temp_dir().join(name);
        let lines = dependencies.iter();
        let lines: String = lines
            .map(|(package, folder)| format!("{package} = {{ path = \"{ROOT}/{folder}\" }}\n"))
            .collect();
        let head = "[package]\nname = \"stranger\"\nedition = \"2024\"\n\n[dependencies]\n";
        let manifest = format!("{head}{lines}\n{}", profiles());
        fs::create_dir_all(folder.join("src")).unwrap();
        fs::write(folder.join("Cargo.toml"), manifest).unwrap();
        fs::write(folder.join("src/main.rs"), PROGRAM).unwrap();
        // the toolchain, too: another one would check everything again
        for file in ["Cargo.lock", "rust-toolchain.toml"] {
            fs::copy(Path::new(ROOT).join(file), folder.join(file)).unwrap();
        }
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

/// The profiles of the workspace: with others, what it has checked would be checked again.
fn profiles() -> String {
    let manifest = fs::read_to_string(Path::new(ROOT).join("Cargo.toml")).unwrap();
    let tables = manifest.split("\n[").filter(|t| t.starts_with("profile."));
    let tables: String = tables.map(|table| format!("[{table}\n")).collect();
    assert!(tables.contains("[profile.dev]"), "{manifest}");
    tables
}

fn first_word(line: &str) -> Option<String> {
    line.split_whitespace().next().map(str::to_owned)
}

#[test]
fn networks_and_update_compile_without_simulator_or_command_line() {
    let crates = [("covers-rl", "rl"), ("covers-equivariant", "equivariant")];
    let stranger = Stranger::new(&crates);
    assert_eq!(stranger.unwanted(), [""; 0]);
    cargo(&stranger.0, &["check", "--quiet"]);
}

#[test]
fn the_environments_bring_the_simulator() {
    let stranger = Stranger::new(&[("covers-envs", "envs")]);
    let unwanted = stranger.unwanted();
    for expected in [
        "bindgen",
        "covers-envs",
        "covers-mujoco",
        "covers-mujoco-sys",
    ] {
        assert!(
            unwanted.iter().any(|name| name == expected),
            "{expected}: {unwanted:?}"
        );
    }
}
