//! A sweep that several workers share, one of which is killed.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use covers::sweep::{SweepJob, SweepPlan};
use covers::{Provenance, RunFolder};

use crate::common::{Scratch, assert_same, bytes, checkpoints, contents, full, reference};

const PLAN: &str = r#"{
    "methods": ["covers", "equi"],
    "seeds": [1000],
    "budget": "smoke",
    "set": ["envs.embodiment=hand", "schedule.cycles=1", "checkpoints.every=1",
        "schedule.groups=[{\"group\": \"window-open\", \"decisions\": 960, \"variants\": [\"identity\"]}]"]
}"#;

/// A plan in a folder of its own, and where its runs are.
struct Sweep {
    _scratch: Scratch,
    plan: PathBuf,
    runs: PathBuf,
}

impl Sweep {
    fn new() -> Self {
        let scratch = Scratch::new("sweep");
        let (plan, runs) = (scratch.0.join("plan.json"), scratch.0.join("runs"));
        fs::write(&plan, PLAN).unwrap();
        Self { _scratch: scratch, plan, runs }
    }

    fn jobs(&self) -> Vec<SweepJob> {
        SweepPlan::read(&self.plan).unwrap().jobs().unwrap()
    }

    fn worker(&self, options: &[&str]) -> Child {
        self.worker_in(&self.runs, options)
    }

    /// Starts a worker that sees the folder of runs at another path.
    fn worker_in(&self, runs: &Path, options: &[&str]) -> Child {
        Command::new(env!("CARGO_BIN_EXE_covers"))
            .arg("sweep")
            .args([&self.plan, Path::new("--runs"), runs])
            .args(options)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap()
    }
}

/// Waits until it is so, while the worker is at work.
fn wait_until(worker: &mut Child, mut it_is_so: impl FnMut() -> bool) {
    let clock = Instant::now();
    while !it_is_so() {
        assert!(clock.elapsed() < Duration::from_secs(60), "waited in vain");
        assert_eq!(worker.try_wait().unwrap(), None, "the worker has ended");
        sleep(Duration::from_millis(2));
    }
}

/// Whether a checkpoint is there whose writing has ended.
fn has_checkpoint(run: &Path) -> bool {
    let folder = run.join("checkpoints");
    let whole = |file: &PathBuf| file.extension().is_some_and(|ending| ending == "safetensors");
    folder.exists() && checkpoints(run).iter().any(whole)
}

fn said(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

#[test]
fn workers_that_are_killed_leave_jobs_that_others_finish() {
    let sweep = Sweep::new();
    let jobs = sweep.jobs();
    let [first, second] = [0, 1].map(|job| jobs[job].folder_path(&sweep.runs));
    let mut killed = sweep.worker(&[]);
    wait_until(&mut killed, || RunFolder::from_path(&first).holds_run());
    let (other, alone) = (sweep.worker(&[]), sweep.worker(&["--job", "0"]));
    // then the other worker has passed over the first job
    wait_until(&mut killed, || RunFolder::from_path(&second).holds_run());
    wait_until(&mut killed, || has_checkpoint(&first));
    killed.kill().unwrap();
    assert_eq!(killed.wait().unwrap().code(), None);
    assert!(!RunFolder::from_path(&first).is_finished());
    for worker in [other, alone] {
        let output = worker.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(0));
        assert!(said(&output).contains("covers-seed1000: done"));
    }
    for job in &jobs {
        assert_same(&bytes(&job.folder_path(&sweep.runs)), &reference(&job.experiment));
    }
    let writers = Provenance::read(&first).unwrap();
    assert_eq!(writers.len(), 2);
    assert!(writers[1].rollouts_before > 0, "started from the beginning");
}

/// Two paths to the folder of runs, as of two machines whose file server does not share locks.
struct Machines {
    first: PathBuf,
    second: PathBuf,
}

impl Machines {
    /// Mounts the folder twice.
    fn mount(sweep: &Sweep) -> Self {
        fs::create_dir(&sweep.runs).unwrap();
        let mount = |name: &str| {
            let path = sweep.runs.with_file_name(name);
            fs::create_dir(&path).unwrap();
            // without caches, as a client of NFS that opens a file anew asks the server
            let options = "attr_timeout=0,entry_timeout=0,negative_timeout=0";
            let mut bindfs = Command::new("bindfs");
            bindfs.args(["-o", options]).args([&sweep.runs, &path]);
            let mounted = bindfs.status().is_ok_and(|status| status.success());
            assert!(mounted, "{bindfs:?}: is bindfs installed?");
            path
        };
        Self { first: mount("first"), second: mount("second") }
    }
}

impl Drop for Machines {
    fn drop(&mut self) {
        for path in [&self.first, &self.second] {
            let _ = Command::new("umount").arg("--lazy").arg(path).status();
        }
    }
}

/// A frozen worker loses its lock as a client of a file server does, another one finishes the run,
/// and the first goes on before or after that end. Full: 200 times, on mounts that do not share
/// locks.
#[test]
fn workers_that_were_frozen_while_others_took_over_damage_no_run() {
    let trials = if full() { 200 } else { 2 };
    let mut expected = None;
    for trial in 0..trials {
        let sweep = Sweep::new();
        let machines = full().then(|| Machines::mount(&sweep));
        let paths = machines.as_ref().map_or([&sweep.runs; 2], |m| [&m.first, &m.second]);
        let job = &sweep.jobs()[0];
        let folder = job.folder_path(&sweep.runs);
        let expected = expected.get_or_insert_with(|| reference(&job.experiment));
        let mut first = sweep.worker_in(paths[0], &["--job", "0"]);
        wait_until(&mut first, || has_checkpoint(&folder));
        // at another moment of its work each time
        sleep(Duration::from_millis(17 * trial % 500));
        assert_eq!(first.try_wait().unwrap(), None, "{trial}: the worker has ended");
        let frozen = first;
        signal(&frozen, "STOP");
        if machines.is_none() {
            fs::remove_file(folder.join("lock")).unwrap();
        }
        let other = sweep.worker_in(paths[1], &["--job", "0"]);
        let thaws_first = trial % 2 == 1;
        if thaws_first {
            sleep(Duration::from_millis(300));
            signal(&frozen, "CONT");
        }
        let other = other.wait_with_output().unwrap();
        assert_eq!(other.status.code(), Some(0), "{trial}: {}", said(&other));
        if !thaws_first {
            assert_same(&bytes(&folder), expected);
            signal(&frozen, "CONT");
        }
        let output = frozen.wait_with_output().unwrap();
        let printed = said(&output);
        assert_eq!(output.status.code(), Some(0), "{trial}: {printed}");
        if !thaws_first {
            let taken_over = printed.find("was taken over by process").unwrap();
            assert!(taken_over < printed.find("covers-seed1000: done").unwrap(), "{printed}");
        }
        assert_same(&bytes(&folder), expected);
        RunFolder::from_path(&folder).verify_table_checksums().unwrap();
    }
}

/// A worker whose lock nothing releases, since its machine still runs.
#[test]
fn a_run_whose_worker_stands_still_is_taken_over() {
    let sweep = Sweep::new();
    let job = &sweep.jobs()[0];
    let folder = job.folder_path(&sweep.runs);
    let mut frozen = sweep.worker(&["--job", "0"]);
    wait_until(&mut frozen, || has_checkpoint(&folder));
    signal(&frozen, "STOP");
    let waiting = &["--job", "0", "--take-over-after", "3"];
    let output = sweep.worker(waiting).wait_with_output().unwrap();
    let printed = said(&output);
    assert_eq!(output.status.code(), Some(0), "{printed}");
    assert!(printed.contains("has not changed for 3 seconds: taken over"), "{printed}");
    let finished = contents(&folder);
    signal(&frozen, "CONT");
    assert_eq!(frozen.wait_with_output().unwrap().status.code(), Some(0));
    assert!(contents(&folder) == finished, "the frozen worker changed a file");
    assert_same(&bytes(&folder), &reference(&job.experiment));
}

/// Two machines whose file server does not share locks: the later worker finishes the run, and the
/// earlier one does not take it back.
#[test]
fn of_two_live_workers_without_shared_locks_one_finishes_the_run() {
    let sweep = Sweep::new();
    let job = &sweep.jobs()[0];
    let folder = job.folder_path(&sweep.runs);
    let mut first = sweep.worker(&["--job", "0"]);
    wait_until(&mut first, || has_checkpoint(&folder));
    fs::remove_file(folder.join("lock")).unwrap();
    let second = sweep.worker(&["--job", "0"]);
    for worker in [second, first] {
        let output = worker.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    }
    assert_same(&bytes(&folder), &reference(&job.experiment));
    assert_eq!(Provenance::read(&folder).unwrap().len(), 2);
}

#[test]
fn a_job_whose_tables_changed_after_its_end_is_not_done() {
    let sweep = Sweep::new();
    let folder = sweep.jobs()[0].folder_path(&sweep.runs);
    let work = || said(&sweep.worker(&["--job", "0"]).wait_with_output().unwrap());
    work();
    let finished = bytes(&folder);
    for file in ["metrics.csv", "evaluation.csv", "recognition.csv"] {
        fs::write(folder.join(file), "").unwrap();
    }
    let printed = work();
    assert!(printed.contains("restoring the tables"), "{printed}");
    assert_same(&bytes(&folder), &finished);
    let again = work();
    assert_eq!(again, "covers-seed1000: done\n");
}

#[test]
fn a_worker_whose_output_is_closed_leaves_a_checkpoint() {
    let sweep = Sweep::new();
    let folder = sweep.jobs()[0].folder_path(&sweep.runs);
    let mut worker = sweep.worker(&["--job", "0"]);
    drop(worker.stdout.take());
    assert_eq!(worker.wait().unwrap().code(), Some(3));
    assert!(!RunFolder::from_path(&folder).is_finished());
    assert!(has_checkpoint(&folder));
}

fn signal(process: &Child, name: &str) {
    let id = process.id().to_string();
    let status = Command::new("kill").args(["-s", name, &id]).status();
    assert!(status.unwrap().success());
}

#[test]
fn runs_of_other_settings_are_left_alone() {
    let sweep = Sweep::new();
    for job in sweep.jobs() {
        let folder = job.folder_path(&sweep.runs);
        fs::create_dir_all(&folder).unwrap();
        let folder = RunFolder::from_path(&folder);
        let other = job.experiment.with_seed(9);
        folder.write_experiment(&other).unwrap();
    }
    let output = sweep.worker(&[]).wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(said(&output).matches("other settings").count(), 2);
    for job in sweep.jobs() {
        let files = fs::read_dir(job.folder_path(&sweep.runs)).unwrap();
        assert_eq!(files.count(), 1);
    }
}

#[test]
fn printed_commands_say_threads_and_kubernetes_takes_paths_on_its_volume_alone() {
    let sweep = Sweep::new();
    let output = sweep.worker(&["--threads", "3", "--slurm"]);
    let script = said(&output.wait_with_output().unwrap());
    assert!(script.contains("--threads 3"), "{script}");
    assert!(script.contains("#SBATCH --mem="), "{script}");
    for options in [
        &["--slurm", "--name", "x"][..],
        &["--hq", "--time", "1"],
        &["--hq", "--parallel", "1"],
        &["--slurm", "--hq"],
        &["--time", "1"],
        &["--slurm", "--time", "1; rm"],
    ] {
        let refusal = sweep.worker(options).wait_with_output().unwrap();
        assert_eq!(refusal.status.code(), Some(2), "{options:?}");
    }
    let refused = sweep.worker(&["--kubernetes", "covers"]);
    assert_eq!(refused.wait_with_output().unwrap().status.code(), Some(1));
}
