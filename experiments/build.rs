//! Passes the current git commit to the crate, for the provenance of runs.

use std::path::Path;
use std::process::Command;

/// Folder of this crate in the repository.
const FOLDER: &str = "experiments/";

fn main() {
    // a package unpacked inside another repository must not report that repository's commit
    if git(&["rev-parse", "--show-prefix"]).as_deref() != Some(FOLDER) {
        return;
    }
    // any tracked crate can make the sources differ from the commit, so all of them are watched
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

/// Returns the standard output of git; `None` if git fails.
fn git(arguments: &[&str]) -> Option<String> {
    let mut command = Command::new("git");
    // without locks, a build cannot make a git command that runs at the same time fail
    let output = command.arg("--no-optional-locks").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}
