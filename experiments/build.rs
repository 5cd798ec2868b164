//! Tells the crate which commit it is built from, for the provenance of runs.

use std::path::Path;
use std::process::Command;

/// This crate's folder in the repository.
const FOLDER: &str = "experiments/";

fn main() {
    // a package that was unpacked into somebody else's repository is not that repository's
    if git(&["rev-parse", "--show-prefix"]).as_deref() != Some(FOLDER) {
        return;
    }
    // whether sources are those of the commit follows from every crate's files
    let tracked = git(&["ls-tree", "--name-only", "HEAD", "../"]).unwrap_or_default();
    let crates = tracked.lines().filter(|entry| Path::new(entry).join("Cargo.toml").exists());
    for path in crates.chain(["../src", "../Cargo.toml", "../Cargo.lock"]) {
        println!("cargo::rerun-if-changed={path}");
    }
    for name in ["HEAD", "logs/HEAD"] {
        if let Some(path) = git(&["rev-parse", "--git-path", name]) {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    let Some(commit) = git(&["rev-parse", "HEAD"]) else {
        return;
    };
    println!("cargo::rustc-env=COVERS_COMMIT={commit}");
    let changes = ["status", "--porcelain", "--untracked-files=no"];
    if let Some(changes) = git(&changes) {
        println!("cargo::rustc-env=COVERS_CLEAN={}", changes.is_empty());
    }
}

/// Standard output of git; `None` if it fails. It takes no locks, so that it disturbs no other git.
fn git(arguments: &[&str]) -> Option<String> {
    let mut command = Command::new("git");
    let output = command.arg("--no-optional-locks").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}
