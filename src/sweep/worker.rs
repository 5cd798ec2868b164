//! A worker of a sweep: it claims one job after another until none is left.

use std::io::Write;
use std::path::Path;

use crate::error::CoversError;
use crate::overrides::same;
use crate::runs::{Event, Run, RunFolder, Stop};

use super::plan::Job;

/// What became of a job.
enum Fate {
    Done,
    Stopped,
    /// Another worker has it.
    Taken,
}

/// Does every job that no other worker does or has done, and tells of it. The folder of a run and
/// its lock are all that workers share. Returns whether a stop was wished for.
///
/// # Errors
/// [`CoversError::Jobs`] names the jobs that failed, after all others are done; an `out` that cannot
/// be written to.
pub fn work(
    jobs: &[Job],
    runs: &Path,
    threads: usize,
    stop: &Stop,
    out: &mut impl Write,
) -> Result<bool, CoversError> {
    std::fs::create_dir_all(runs).map_err(|error| CoversError::write(runs, error))?;
    let mut failed = Vec::new();
    for job in jobs {
        match run(job, runs, threads, stop, out) {
            Ok(Fate::Done) => say(out, job, "done")?,
            Ok(Fate::Taken) => say(out, job, "another worker has it")?,
            Ok(Fate::Stopped) => return Ok(true),
            Err(error) => {
                say(out, job, &format!("error: {error}"))?;
                failed.push(job.name.clone());
            }
        }
    }
    if failed.is_empty() {
        return Ok(false);
    }
    Err(CoversError::Jobs { failed })
}

fn run(
    job: &Job,
    runs: &Path,
    threads: usize,
    stop: &Stop,
    out: &mut impl Write,
) -> Result<Fate, CoversError> {
    let path = job.folder(runs);
    let folder = RunFolder::open(&path);
    if folder.holds_run() {
        let there = folder.experiment()?.with_threads(1);
        same(&path, &job.experiment, &there)?;
        if folder.is_finished() {
            return Ok(Fate::Done);
        }
    }
    if stop.requested() {
        return Ok(Fate::Stopped);
    }
    let mut run = match claim(job, folder, threads) {
        Err(CoversError::Locked { .. }) => return Ok(Fate::Taken),
        other => other?,
    };
    run.stop_at(stop.clone());
    say(out, job, run.notice())?;
    while let Some(event) = run.advance()? {
        if let Event::Evaluation(evaluation) = event {
            let rollouts = evaluation.rollout + 1;
            say(out, job, &format!("evaluated after {rollouts} rollouts"))?;
        }
    }
    if !run.is_finished() {
        run.save()?;
        say(
            out,
            job,
            &format!("stopped after {} rollouts", run.ledger().rollouts),
        )?;
        return Ok(Fate::Stopped);
    }
    run.summary().map(|_| Fate::Done)
}

/// Begins the job's run or goes on with it.
fn claim(job: &Job, folder: RunFolder, threads: usize) -> Result<Run, CoversError> {
    if folder.holds_run() {
        return Run::resume(folder.path(), Some(threads));
    }
    let path = folder.path();
    std::fs::create_dir_all(path).map_err(|error| CoversError::write(path, error))?;
    match Run::start(job.experiment.clone().with_threads(threads), folder.clone()) {
        // another worker began it between the question and the claim
        Err(CoversError::Occupied { .. }) => Run::resume(folder.path(), Some(threads)),
        other => other,
    }
}

fn say(out: &mut impl Write, job: &Job, line: &str) -> Result<(), CoversError> {
    let written = writeln!(out, "{}: {line}", job.name).and_then(|()| out.flush());
    written.map_err(|error| CoversError::write(Path::new("standard output"), error))
}
