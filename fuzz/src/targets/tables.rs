//! Fuzz target of a run's tables, as reports and resumed runs read them.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use covers::experiments::timings::{TimingSums, first_timing_rows};
use covers::presets::{Budget, Method};
use covers::report::Report;
use covers::{CoversError, RunData, RunFolder};

use super::{Reading, Target, accepted, measured, own_path, texts};

pub const TABLES: Target = Target::new("tables", read, tables).holding(512, 1 << 17).tried(2_000);

const NAMES: [&str; 6] = [
    "metrics.csv",
    "evaluation.csv",
    "timings.csv",
    "provenance.jsonl",
    "units.csv",
    "recognition.csv",
];

/// Folder of a run that has ended.
static RUN: LazyLock<PathBuf> = LazyLock::new(|| {
    let runs = own_path("tables");
    let folder = RunFolder::create(&runs, "covers-seed0").and_then(|folder| {
        folder.write_experiment(&Budget::Smoke.preset_experiment(Method::Covers))?;
        Ok(folder)
    });
    let folder = folder.unwrap_or_else(|error| panic!("{}: {error}", runs.display()));
    write("summary.json", b"{}", folder.path());
    folder.path().to_owned()
});

fn write(name: &str, bytes: &[u8], folder: &Path) {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}

/// Reads files that stand one after the other, separated by zeros.
fn read(input: &[u8]) -> Option<Reading> {
    let parts = input.split(|&byte| byte == 0).chain([&b""[..]; 5]);
    let files: Vec<(&str, &[u8])> = NAMES.into_iter().zip(parts).collect();
    for (name, bytes) in &files {
        write(name, bytes, &RUN);
    }
    measured(|| {
        go_on(files[2].1);
        // viewers of an unfinished run read its complete rows
        drop(RunData::read_partial(&RUN));
        accepted(RunData::read(&RUN).map_err(CoversError::from).and_then(report))
    })
}

/// Checks the rows of timings that a resumed run keeps.
fn go_on(table: &[u8]) {
    let kept = first_timing_rows(table, 2);
    assert_eq!(first_timing_rows(kept.as_bytes(), 2), kept);
    let known = TimingSums::of_table(kept.as_bytes());
    let rate = known.decisions_per_second();
    assert!(rate.is_none_or(|rate| !rate.is_nan()));
}

/// Writes a report of the run alone.
fn report(run: RunData) -> Result<(), CoversError> {
    let report = Report::new(vec![run])?;
    assert!(!report.markdown().is_empty());
    Ok(report.write(&RUN.join("report"))?)
}

fn tables() -> Vec<Vec<u8>> {
    texts([
        "rollout,decisions,group,last_group,straddles,policy,created,reward,success,success_at_end\n\
         0,80,a,a,false,0,false,12.5,0.5,0.25\n1,160,a,b,true,0,false,,,\n\
         2,240,b,b,false,1,true,500,1,1\n\0\
         rollouts,decisions,group,element,seen,policy,episodes,success,success_at_end,reward\n\
         0,0,a,identity,true,0,8,0,0,1.5\n0,0,b,flip x,false,0,8,0,0,1\n\
         3,240,a,identity,true,0,8,0.5,0.25,250\n3,240,b,flip x,false,1,8,1,1,300\n\0\
         rollout,decisions,total,environments,inference,assignment,update\n\
         0,80,1.5,0.5,0.5,0.25,0.25\n1,80,2,1,0,0,1\n2,80,1e3,1,1,1,1\n\0\
         {\"rollouts\":0,\"started\":-1,\"command\":[\"covers\"],\"version\":\"0.1.0\",\
         \"commit\":\"0123456789abcdef\",\"clean\":false,\"mujoco\":\"2.2.2\",\"renderer\":\"none\",\
         \"processor\":\"a\",\"instructions\":[],\"system\":\"linux\",\"threads\":1}\n\0\
         rollouts,decisions,policy,units,dormant\n3,240,0,8,1\n\0\
         group,element,episodes,policy,times\na,identity,1,0,1\na,identity,4,0,1\n\
         a,identity,20,,1\nb,flip x,1,1,1\nb,flip x,4,1,1\nb,flip x,20,0,1\n",
        "decisions,group,last_group,straddles,policy,reward,success\n8,a,a,false,0,1,1\n\0\
         rollouts,decisions,group,element,seen,policy,episodes,success,success_at_end,reward,\
         own_policy,own_success,own_success_at_end,own_reward\n\
         1,8,a,identity,true,1,8,1,1,1,0,0.5,0.5,2\n\0\0\0\0\
         group,element,episodes,policy,times\na,identity,1,1,1\na,identity,4,0,1\n\
         a,identity,20,0,1\n",
        "\0\0\0",
        "decisions,group\n\"8\",\"a\"\"b\"\n",
    ])
}
