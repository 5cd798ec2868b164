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
    // Watched are the sources of every tracked crate, and no folder that builds write to. Changes
    // elsewhere show in COVERS_CLEAN at the next rebuild.
    let tracked = git(&["ls-tree", "--name-only", "HEAD", "../"]).unwrap_or_default();
    for folder in tracked.lines().chain([".."]).map(Path::new) {
        for name in ["src", "Cargo.toml", "build.rs"] {
            let path = folder.join(name);
            if folder.join("Cargo.toml").exists() && path.exists() {
                println!("cargo::rerun-if-changed={}", path.display());
            }
        }
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
