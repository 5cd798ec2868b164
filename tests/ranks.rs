//! Runs that several ranks compute together, which are threads here, write the bytes of one
//! process. `tests/mpi.sh` does the same with processes that `mpirun` starts.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::process;
use std::sync::{Arc, Barrier, Mutex};
use std::thread;

use covers::presets::Method;
use covers::{DeviceChoice, Experiment, Run, RunFolder};
use envs::TaskRegistry;
use rl::{ProcessCommunicator, ProcessRanks};

use crate::common::runs::{bytes, two_groups};
use crate::common::scratch::Scratch;

/// A thread as one of several ranks.
struct ThreadRank {
    rank: usize,
    shared: Arc<(Barrier, Mutex<Vec<Vec<u8>>>)>,
}

impl ProcessCommunicator for ThreadRank {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.shared.1.lock().unwrap().len()
    }

    fn all_gather(&self, own: &[u8]) -> Vec<u8> {
        let (barrier, messages) = &*self.shared;
        messages.lock().unwrap()[self.rank] = own.to_vec();
        barrier.wait();
        let all = messages.lock().unwrap().concat();
        // the next message must not replace one that others have not read
        barrier.wait();
        all
    }
}

/// Prepares a run on each of `size` ranks, and advances it `events` times or to its end.
fn advance(folder: &Path, size: usize, events: usize, prepare: impl Fn(RunFolder) -> Run + Sync) {
    let shared = Arc::new((Barrier::new(size), Mutex::new(vec![Vec::new(); size])));
    let work = |rank| {
        let ranks = ProcessRanks::new(Arc::new(ThreadRank { rank, shared: Arc::clone(&shared) }));
        let mut run = prepare(RunFolder::from_path(folder).with_process_ranks(ranks));
        for _ in 0..events {
            run.advance().unwrap();
        }
        run.save_checkpoint().unwrap();
    };
    let work = &work;
    thread::scope(|scope| {
        for rank in 0..size {
            // the other ranks would wait for one that has panicked
            scope.spawn(move || {
                catch_unwind(AssertUnwindSafe(|| work(rank))).unwrap_or_else(|_| process::exit(101))
            });
        }
    });
}

/// Two groups and four environments; minibatches have 4 or 8 chunks.
fn experiment(method: Method) -> Experiment {
    let mut experiment = two_groups(method).with_threads(1);
    experiment.schedule.groups.iter_mut().for_each(|plan| plan.decisions = 2 * 80);
    experiment.envs.num_envs = 4;
    experiment.evaluation.recognition_repeats = 1;
    experiment
}

/// More events than a run of [`experiment`] has.
const ALL: usize = 100;

#[test]
fn several_ranks_write_the_bytes_of_one_process() {
    // more ranks than environments, and uneven shares
    for (method, size) in [(Method::Covers, 5), (Method::EquiSac, 3)] {
        let scratch = Scratch::new("ranks");
        let run = |ranks| {
            let folder = RunFolder::create(&scratch.0, "run").unwrap();
            let start = |own| Run::start(experiment(method), own).unwrap();
            advance(folder.path(), ranks, ALL, start);
            bytes(folder.path())
        };
        let (expected, found) = (run(1), run(size));
        for table in ["metrics.csv", "evaluation.csv"] {
            assert!(expected[Path::new(table)].len() > 100, "{table}");
        }
        for (file, whole) in &expected {
            let is_same = found.get(file) == Some(whole);
            assert!(is_same, "{method:?} on {size} ranks: {} differs", file.display());
        }
    }
}

#[test]
fn a_run_goes_on_with_another_number_of_ranks() {
    let scratch = Scratch::new("ranks");
    let [whole, parts] = [0, 1].map(|_| RunFolder::create(&scratch.0, "run").unwrap());
    let start = |folder| Run::start(experiment(Method::Covers), folder).unwrap();
    advance(whole.path(), 1, ALL, start);
    advance(parts.path(), 3, 2, start);
    assert!(bytes(parts.path()) != bytes(whole.path()));
    advance(parts.path(), 2, ALL, |folder| {
        Run::resume_with_tasks(folder, Some(1), DeviceChoice::Cpu, TaskRegistry::with_all())
            .unwrap()
    });
    assert!(bytes(parts.path()) == bytes(whole.path()));
}

#[cfg(not(feature = "mpi"))]
#[test]
fn several_processes_are_refused_without_mpi() {
    let scratch = Scratch::new("without-mpi");
    let folder = scratch.0.join("run");
    for size in ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE"] {
        let output = process::Command::new(env!("CARGO_BIN_EXE_covers"))
            .args(["train", "--budget", "smoke", "--folder"])
            .arg(&folder)
            .env(size, "3")
            .output()
            .unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{size}: {said}");
        assert!(said.contains("`mpirun` or `srun` started 3 processes"), "{size}: {said}");
        assert!(!folder.exists());
    }
}
