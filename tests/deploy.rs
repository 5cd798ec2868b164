//! `covers deploy` with a table and a sweep: what it writes, and which trials it runs again.

use std::fs;
use std::path::Path;

use covers::CoversError;

use crate::common::{covers, scratch::Scratch};

/// What the program prints, deploying the policies for robots that come with the project.
fn deployed(out: &Path, rest: &str) -> Result<String, CoversError> {
    let run = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/pretrained-robot");
    let (run, out) = (run.display(), out.display());
    let line = format!("deploy {run} --task goal-reach --out {out} {rest}");
    covers(&line.split(' ').collect::<Vec<_>>())
}

#[test]
fn a_sweep_runs_the_first_trials_again_but_for_nominal_amounts() {
    let scratch = Scratch::new("deploy");
    let folder = scratch.0.join("new");
    let sweep = "--trials 2 --sweep-trials 1 --sweep mask-growth=20,60";
    let printed = deployed(&folder, sweep).unwrap();
    assert_eq!(printed.matches("among the trials above").count(), 1, "{printed}");

    let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
    let trials = read("trials.csv");
    assert_eq!(trials.lines().count(), 1 + 4 * 2);
    assert!(read("table.md").contains("| goal-reach | 8 |"));
    // a row of the nominal amount is that of the same trial
    let swept = read("mask-growth.csv");
    let rows = |amount: &str| {
        let start = format!("mask-growth,{amount},");
        let rows = swept.lines().filter_map(|row| row.strip_prefix(&start));
        rows.map(str::to_owned).collect::<Vec<_>>()
    };
    let first = trials.lines().skip(1).filter(|row| row.split(',').nth(2) == Some("0"));
    assert_eq!(rows("20"), first.collect::<Vec<_>>());
    assert_eq!((rows("20").len(), rows("60").len()), (4, 4));
    assert!(read("mask-growth.svg").contains("goal-reach at 60: "));

    let refused = deployed(&folder, sweep).unwrap_err().to_string();
    assert!(refused.contains("table.md"), "{refused}");
}
