//! Tells the crate which commit it is built from, for the provenance of runs.

use std::path::Path;
use std::process::Command;

fn main() {
    // what follows from sources: whether they are those of the commit
    for folder in [
        "src",
        "build.rs",
        "Cargo.toml",
        "cluster",
        "envs",
        "equivariant",
        "evidence",
        "inpainting",
        "mujoco",
        "mujoco-sys",
        "rl",
        "symmetry",
    ] {
        if Path::new(folder).exists() {
            println!("cargo::rerun-if-changed={folder}");
        }
    }
    // a package that was unpacked into somebody else's repository is not that repository's
    if git(&["rev-parse", "--show-prefix"]).as_deref() != Some("") {
        return;
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

/// What git says; none where it fails. It takes no locks, so that it disturbs no other git.
fn git(arguments: &[&str]) -> Option<String> {
    let mut command = Command::new("git");
    let output = command
        .arg("--no-optional-locks")
        .args(arguments)
        .output()
        .ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}
