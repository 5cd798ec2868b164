//! Worker of a sweep, which claims one job after another until all are finished.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};

use envs::TaskRegistry;
use experiments::cli::print_escaped;
use experiments::printable::printable_message;
use experiments::{Experiment, FileStamps, Run, RunError, RunEvent, RunFolder, StopSignal};
use learner::DeviceChoice;
use learner::overrides::check_same_settings;

use super::plan::SweepJob;

/// Time between attempts to claim jobs that other workers run.
const RETRY_INTERVAL: Duration = Duration::from_secs(2);
/// Times to wait before the next attempts after an error of a disk that may pass.
const DISK_RETRY_INTERVALS: [Duration; 4] =
    [RETRY_INTERVAL, Duration::from_secs(15), Duration::from_secs(60), Duration::from_secs(300)];
/// Time between checks of the stop signal while a worker waits.
const STOP_POLL: Duration = Duration::from_millis(50);

/// Settings of one worker of a sweep: folder, threads, device, and time until it takes over runs
/// that stand still.
#[derive(Clone, Copy, Debug)]
pub struct SweepWorkerSettings<'a> {
    /// Folder that holds the folders of the runs.
    pub runs: &'a Path,
    /// Worker threads of each run.
    pub threads: usize,
    /// Device of policy updates.
    pub device: DeviceChoice,
    /// Time after which a run whose files do not change is taken over from its worker; `None` to
    /// wait for ever.
    pub take_over_after: Option<Duration>,
}

/// Outcome of one worker of a sweep: `true` if it was stopped with jobs left, and the jobs that
/// failed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SweepWorkerOutcome {
    /// `true` if a stop was requested while jobs were left.
    pub stopped: bool,
    /// Names of the jobs that failed; their errors were printed.
    pub failed_jobs: Vec<String>,
}

/// Outcome of a worker's attempt to run one job of a sweep.
enum JobOutcome {
    Done,
    Stopped,
    /// Job of the sweep that another worker runs.
    Taken,
}

/// Works on the sweep until every job has finished or failed, or until a stop is requested, and
/// prints its progress. Jobs of other workers are left to them, and taken over if such a worker
/// ends early or stands still. Workers share nothing but the folders of the runs and their locks.
///
/// # Errors
/// [`RunError::Write`] if the folder of the runs cannot be created.
pub fn run_sweep_worker(
    jobs: &[SweepJob],
    settings: SweepWorkerSettings,
    stop: &StopSignal,
    out: &mut impl Write,
) -> Result<SweepWorkerOutcome, RunError> {
    let runs = settings.runs;
    std::fs::create_dir_all(runs).map_err(RunError::write_error_mapper(runs))?;
    let (failed, lost, seen) = Default::default();
    let mut worker = Worker { settings, stop, out, failed, lost, seen };
    let stopped = worker.work(jobs);
    Ok(SweepWorkerOutcome { stopped, failed_jobs: worker.failed })
}

struct Worker<'a, W> {
    settings: SweepWorkerSettings<'a>,
    stop: &'a StopSignal,
    out: &'a mut W,
    failed: Vec<String>,
    /// Names of the jobs that other workers took over from this one.
    lost: Vec<String>,
    /// Files of the runs of other workers by job, and since when they have not changed.
    seen: BTreeMap<String, (FileStamps, Instant)>,
}

impl<W: Write> Worker<'_, W> {
    /// Repeats passes over the sweep's jobs until none is left; returns `true` after a stop.
    fn work(&mut self, jobs: &[SweepJob]) -> bool {
        let mut left: Vec<&SweepJob> = jobs.iter().collect();
        let mut waited_for = Vec::new();
        while !left.is_empty() {
            let Some(taken) = self.pass(&left) else {
                return true;
            };
            // a pass that finished nothing: all remaining jobs run elsewhere
            if taken.len() == left.len() {
                self.announce(&taken, &mut waited_for);
                self.wait(RETRY_INTERVAL);
            }
            left = taken;
        }
        false
    }

    /// Tries each job of the sweep once. Returns those of other workers; `None` after a stop.
    fn pass<'j>(&mut self, jobs: &[&'j SweepJob]) -> Option<Vec<&'j SweepJob>> {
        let mut taken = Vec::new();
        for &job in jobs {
            match self.run_with_retries(job) {
                Ok(JobOutcome::Done) => self.say(job, "done"),
                Ok(JobOutcome::Taken) => taken.push(job),
                Ok(JobOutcome::Stopped) => return None,
                // Another process took the run over because this one was frozen, or because the
                // file server does not share locks. Claiming it back would stop that process.
                Err(error @ RunError::TakenOver(_)) => {
                    self.say(job, &error.to_string());
                    self.lost.push(job.folder_name.clone());
                    taken.push(job);
                }
                Err(error) => {
                    self.say(job, &format!("error: {}", printable_message(&error)));
                    self.failed.push(job.folder_name.clone());
                }
            }
        }
        Some(taken)
    }

    /// Prints once for each job that this worker waits for it.
    fn announce<'j>(&mut self, taken: &[&'j SweepJob], waited_for: &mut Vec<&'j str>) {
        for &job in taken {
            if !waited_for.contains(&job.folder_name.as_str()) {
                let remedy = match self.settings.take_over_after {
                    None => " (`--take-over-after` takes over runs that stand still)",
                    Some(_) => "",
                };
                self.say(job, &format!("another worker has it: waiting{remedy}"));
                waited_for.push(&job.folder_name);
            }
        }
    }

    /// Waits for this time, or until a stop is requested.
    fn wait(&self, time: Duration) {
        let clock = Instant::now();
        while clock.elapsed() < time && !self.stop.is_requested() {
            sleep(STOP_POLL);
        }
    }

    /// Runs a job, and tries again after errors of the disk that may pass: a quota that is full for
    /// a minute must not fail job after job.
    fn run_with_retries(&mut self, job: &SweepJob) -> Result<JobOutcome, RunError> {
        for interval in DISK_RETRY_INTERVALS {
            match self.run(job) {
                Err(error) if error.is_transient() => {
                    let (message, seconds) = (printable_message(&error), interval.as_secs());
                    self.say(job, &format!("error: {message}; tried again in {seconds} seconds"));
                    self.wait(interval);
                }
                other => return other,
            }
        }
        self.run(job)
    }

    fn run(&mut self, job: &SweepJob) -> Result<JobOutcome, RunError> {
        let folder = RunFolder::from_path(&job.folder_path(self.settings.runs));
        if folder.holds_run() {
            // checked before the run is resumed, which would change its files
            refuse_others(job, &folder, &folder.read_experiment()?)?;
            if folder.is_finished() {
                match folder.verify_table_checksums() {
                    Ok(()) => return Ok(JobOutcome::Done),
                    Err(changed @ RunError::ChangedTable { .. }) => {
                        self.say(job, &format!("{changed}: restoring the tables"));
                    }
                    Err(error) => return Err(error),
                }
            }
        }
        let lost = self.lost.contains(&job.folder_name);
        if lost && !self.frees_stalled(job, &folder)? {
            return Ok(JobOutcome::Taken);
        }
        if self.stop.is_requested() {
            return Ok(JobOutcome::Stopped);
        }
        let mut claimed = claim(job, &folder, self.settings);
        if matches!(claimed, Err(RunError::Locked { .. })) && self.frees_stalled(job, &folder)? {
            claimed = claim(job, &folder, self.settings);
        }
        match claimed {
            Err(RunError::Locked { .. }) => Ok(JobOutcome::Taken),
            other => self.finish(job, other?),
        }
    }

    /// Frees the lock of another worker's run if its files have not changed for too long; returns
    /// `true` if so.
    fn frees_stalled(&mut self, job: &SweepJob, folder: &RunFolder) -> Result<bool, RunError> {
        let Some(limit) = self.settings.take_over_after else {
            return Ok(false);
        };
        let (now, snapshot) = (Instant::now(), folder.file_stamps()?);
        let name = &job.folder_name;
        match self.seen.get(name) {
            Some((seen, since)) if *seen == snapshot => {
                if now - *since < limit {
                    return Ok(false);
                }
                let seconds = limit.as_secs();
                self.say(job, &format!("has not changed for {seconds} seconds: taken over"));
                folder.break_lock()?;
                self.seen.remove(name);
                self.lost.retain(|lost| lost != name);
                Ok(true)
            }
            _ => {
                self.seen.insert(name.clone(), (snapshot, now));
                Ok(false)
            }
        }
    }

    fn finish(&mut self, job: &SweepJob, mut run: Run) -> Result<JobOutcome, RunError> {
        run.set_stop_signal(self.stop.clone());
        self.say(job, &run.start_message_with_memory());
        while let Some(event) = run.advance()? {
            if let RunEvent::Evaluation(evaluation) = event {
                let rollouts = evaluation.rollouts;
                self.say(job, &format!("evaluated after {rollouts} rollouts"));
            }
        }
        if run.is_finished() && run.summary()?.is_some() {
            return Ok(JobOutcome::Done);
        }
        run.save_checkpoint()?;
        let rollouts = run.stats().rollouts;
        self.say(job, &format!("stopped after {rollouts} rollouts"));
        Ok(JobOutcome::Stopped)
    }

    /// Prints a line about a job of the sweep. A closed output stops the worker, which then writes
    /// a checkpoint.
    fn say(&mut self, job: &SweepJob, line: &str) {
        let line = format!("{}: {line}", job.folder_name);
        if let Err(error) = print_escaped(self.out, &line)
            && !self.stop.is_requested()
        {
            // a closed terminal must not make the sweep fail
            let _ = writeln!(std::io::stderr(), "{error}: stopping");
            self.stop.request();
        }
    }
}

/// Starts the job's run or resumes it.
fn claim(
    job: &SweepJob,
    folder: &RunFolder,
    settings: SweepWorkerSettings,
) -> Result<Run, RunError> {
    let SweepWorkerSettings { threads, device, .. } = settings;
    let path = folder.path();
    std::fs::create_dir_all(path).map_err(RunError::write_error_mapper(path))?;
    let resume = || {
        let tasks = TaskRegistry::with_all();
        Run::resume_with_tasks(folder.clone(), Some(threads), device, tasks)
    };
    let start = || {
        let experiment = job.experiment.clone().with_threads(threads).with_device(device)?;
        Run::start(experiment, folder.clone())
    };
    // `resume` takes the lock before any slow step, which matters to workers that try again often
    let run = if folder.holds_run() {
        resume()?
    } else {
        match start() {
            // another worker started the run since
            Err(RunError::FolderHoldsRun { .. }) => resume()?,
            other => other?,
        }
    };
    // checked again under the lock, since another process may have replaced the run before
    refuse_others(job, folder, run.experiment())?;
    Ok(run)
}

/// Rejects a run in the job's folder whose settings differ from the job's.
fn refuse_others(job: &SweepJob, folder: &RunFolder, there: &Experiment) -> Result<(), RunError> {
    let [asked, there] = [&job.experiment, there].map(|run| run.clone().with_threads(1));
    Ok(check_same_settings(folder.path(), &asked, &there)?)
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::path::PathBuf;
    use std::thread;

    use learner::LearnerError;

    use super::*;
    use experiments::presets::{Budget, Method};

    /// Temporary folder with the settings of three jobs that have not started.
    struct Sweep {
        runs: PathBuf,
        jobs: Vec<SweepJob>,
    }

    impl Sweep {
        fn new(name: &str) -> Self {
            let name = format!("covers-worker-{name}-{}", std::process::id());
            let runs = std::env::temp_dir().join(name);
            let job = |seed: u64| SweepJob {
                folder_name: format!("equi-seed{seed}"),
                experiment: Budget::Smoke.preset_experiment(Method::Equi).with_seed(seed),
            };
            let jobs: Vec<SweepJob> = (0..3).map(job).collect();
            let sweep = Self { runs, jobs };
            for each in &sweep.jobs {
                std::fs::create_dir_all(each.folder_path(&sweep.runs)).unwrap();
                sweep.folder(each).write_experiment(&each.experiment).unwrap();
            }
            sweep
        }

        fn folder(&self, job: &SweepJob) -> RunFolder {
            RunFolder::from_path(&job.folder_path(&self.runs))
        }

        fn finish(&self, job: &SweepJob) {
            std::fs::write(job.folder_path(&self.runs).join("summary.json"), "{}").unwrap();
        }

        /// Takes the lock of a job as another worker would.
        fn take(&self, job: &SweepJob) -> File {
            let lock = File::create(job.folder_path(&self.runs).join("lock")).unwrap();
            lock.try_lock().unwrap();
            lock
        }

        fn settings(&self) -> SweepWorkerSettings<'_> {
            let (runs, device) = (&*self.runs, DeviceChoice::Cpu);
            SweepWorkerSettings { runs, threads: 2, device, take_over_after: None }
        }

        fn work(&self, stop: &StopSignal) -> (SweepWorkerOutcome, String) {
            let mut said = Vec::new();
            let ended = run_sweep_worker(&self.jobs, self.settings(), stop, &mut said).unwrap();
            (ended, String::from_utf8(said).unwrap())
        }
    }

    impl Drop for Sweep {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.runs);
        }
    }

    #[test]
    fn a_job_that_another_worker_has_is_waited_for() {
        let sweep = Sweep::new("waits");
        let [first, second, third] = &sweep.jobs[..] else { unreachable!() };
        sweep.finish(first);
        sweep.finish(third);
        let lock = sweep.take(second);
        let (ended, said) = thread::scope(|scope| {
            scope.spawn(|| {
                sleep(Duration::from_millis(200));
                sweep.finish(second);
                drop(lock);
            });
            let result = sweep.work(&StopSignal::default());
            assert!(sweep.folder(second).is_finished(), "{}", result.1);
            result
        });
        assert_eq!(ended, SweepWorkerOutcome::default());
        let expected = [
            "equi-seed0: done",
            "equi-seed2: done",
            "equi-seed1: another worker has it: waiting (`--take-over-after` takes over runs that \
             stand still)",
            "equi-seed1: done",
        ];
        assert_eq!(said.lines().collect::<Vec<_>>(), expected);
    }

    #[test]
    fn failures_are_reported_also_after_a_stop_which_ends_the_waiting() {
        let sweep = Sweep::new("stops");
        let [first, second, third] = &sweep.jobs[..] else { unreachable!() };
        let other = first.experiment.clone().with_seed(9);
        sweep.folder(first).write_experiment(&other).unwrap();
        sweep.finish(third);
        let _lock = sweep.take(second);
        let (stop, clock) = (StopSignal::default(), Instant::now());
        let (ended, said) = thread::scope(|scope| {
            scope.spawn(|| {
                sleep(Duration::from_millis(200));
                stop.request();
            });
            sweep.work(&stop)
        });
        assert!(ended.stopped && ended.failed_jobs == ["equi-seed0"], "{ended:?}");
        assert!(clock.elapsed() < RETRY_INTERVAL, "{:?}", clock.elapsed());
        assert!(said.contains("other settings"), "{said}");
    }

    #[test]
    fn a_job_that_finds_no_room_on_the_disk_is_tried_again() {
        let sweep = Sweep::new("full");
        let job = &sweep.jobs[0];
        let owner = job.folder_path(&sweep.runs).join("owner");
        std::os::unix::fs::symlink("/dev/full", &owner).unwrap();
        sweep.jobs[1..].iter().for_each(|other| sweep.finish(other));
        let (ended, said) = thread::scope(|scope| {
            scope.spawn(|| {
                sleep(RETRY_INTERVAL / 4);
                std::fs::remove_file(owner).unwrap();
                sweep.finish(job);
            });
            sweep.work(&StopSignal::default())
        });
        assert_eq!(ended, SweepWorkerOutcome::default(), "{said}");
        let lines: Vec<&str> = said.lines().collect();
        assert!(lines[0].contains("No space left on device"), "{said}");
        assert!(lines[0].ends_with("; tried again in 2 seconds"), "{said}");
        assert_eq!(lines[1], "equi-seed0: done");
    }

    #[test]
    fn a_run_of_other_settings_that_began_meanwhile_is_refused_and_let_go() {
        let sweep = Sweep::new("others");
        let job = &sweep.jobs[0];
        let folder = sweep.folder(job);
        let other = job.experiment.clone().with_seed(9);
        folder.write_experiment(&other).unwrap();
        let error = claim(job, &folder, sweep.settings()).err().unwrap();
        assert!(
            matches!(error, RunError::Learner(LearnerError::CheckpointSettingsDiffer { .. })),
            "{error}"
        );
        sweep.take(job);
        folder.write_experiment(&job.experiment).unwrap();
        let run = claim(job, &folder, sweep.settings()).unwrap();
        assert_eq!(run.experiment().envs.threads, 2);
    }
}
