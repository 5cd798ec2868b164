//! `covers doctor`: what this machine has, how fast it is, and how to cure what is missing.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Args;
use envs::{Camera, Embodiment, EnvError, RGB, Scene, SceneRenderer, TableTop, TaskGroup};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use symmetry::D2;

use crate::cli::Work;
use experiments::presets::{Budget, Method};
use experiments::{Experiment, Run, RunError, RunFolder, instructions, memory, processor};

/// The version that the environments were measured with.
const MUJOCO: &str = "2.2.2";
/// Pictures that one measurement draws.
const PICTURES: u32 = 100;
/// Memory that a run of COVERS takes (bytes), with room to spare.
const MEMORY: u64 = 1 << 30;
/// Memory that a full replay of 200,000 transitions takes beside it (bytes).
const REPLAY: u64 = 3 << 30;

/// Disk that a run of the budget `full` takes (bytes), with room to spare: its tables, the
/// checkpoints that are kept and the one that is being written. Runs of COVERS took 26 MB, of
/// ordinary networks 39 MB, of replays 51 MB after half of the stream.
const RUN: u64 = 128 << 20;

/// How a machine is examined.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Examples:\n  covers doctor\n  covers doctor --runs /data/runs --json")]
pub struct DoctorOptions {
    /// The folder that runs would go to, which need not exist yet.
    #[arg(long, default_value = "runs")]
    pub runs: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub work: Work,
}

/// Whether a part is as it should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Health {
    /// It is.
    Good,
    /// It works, and could be better.
    Fair,
    /// It does not work.
    Bad,
}

/// What was found of one part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// The part.
    pub part: &'static str,
    /// Whether it is as it should be.
    pub health: Health,
    /// What there is.
    pub found: String,
    /// What to do, where something is to be done.
    pub cure: Option<String>,
}

impl Finding {
    fn good(part: &'static str, found: impl Into<String>) -> Self {
        let (found, cure) = (found.into(), None);
        Self { part, health: Health::Good, found, cure }
    }

    fn bad(part: &'static str, error: &impl std::fmt::Display, cure: &str) -> Self {
        Self::good(part, error.to_string()).unless(false, Health::Bad, cure)
    }

    /// This finding, unless all is `well`: then one that asks for `cure`.
    fn unless(self, well: bool, health: Health, cure: impl Into<String>) -> Self {
        match well {
            true => self,
            false => Self { health, cure: Some(cure.into()), ..self },
        }
    }

    fn line(&self) -> String {
        let Self { part, found, cure, .. } = self;
        let mark = match self.health {
            Health::Good => "ok",
            Health::Fair => "fair",
            Health::Bad => "BAD",
        };
        let cure = cure.iter().map(|cure| format!("\n{:17}{cure}", ""));
        format!("{mark:<4}  {part:<9}  {found}{}", cure.collect::<String>())
    }
}

impl DoctorOptions {
    /// Examines this machine, prints what was found, and says whether everything works.
    ///
    /// # Errors
    /// An `out` that cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<bool, RunError> {
        let findings = examine(self.work.threads.count(), &self.runs);
        let text = match self.work.json {
            true => serde_json::json!(findings).to_string(),
            false => {
                let lines: Vec<String> = findings.iter().map(Finding::line).collect();
                lines.join("\n")
            }
        };
        let written = writeln!(out, "{text}");
        written.map_err(|error| RunError::write(Path::new("standard output"), error))?;
        Ok(findings.iter().all(|found| found.health != Health::Bad))
    }
}

/// What there is, part by part; learning is tried on so many threads, and runs would go to `runs`.
pub fn examine(threads: usize, runs: &Path) -> Vec<Finding> {
    let memory = the_memory();
    // libraries that find no memory end the process
    let may_draw = memory::check_environments(threads).is_ok();
    let mut others = vec![memory, the_disk(runs), the_simulator()];
    if may_draw {
        others.extend([the_pictures(), the_learning(threads)]);
    }
    [vec![the_processor()], the_gpus(), others].concat()
}

/// Every adapter that policies can learn on; nothing in a program without the feature `wgpu`.
#[cfg(feature = "wgpu")]
fn the_gpus() -> Vec<Finding> {
    let adapters = rl::gpu::adapters();
    let cure =
        "policies learn on the processor: install the Vulkan driver of a GPU, if there is one";
    if adapters.is_empty() {
        let none = Finding::good("gpu", "no Vulkan driver");
        return vec![none.unless(false, Health::Fair, cure)];
    }
    // software stands in for a GPU only where there is none
    let any = adapters.iter().any(|adapter| adapter.kind.is_hardware());
    let found = adapters.iter().map(|adapter| {
        let found = Finding::good("gpu", adapter.to_string());
        found.unless(any, Health::Fair, cure)
    });
    found.collect()
}

#[cfg(not(feature = "wgpu"))]
fn the_gpus() -> Vec<Finding> {
    Vec::new()
}

fn the_processor() -> Finding {
    let name = processor().unwrap_or_else(|| "unknown".to_owned());
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let sets = instructions().join(", ");
    let found = format!("{name}, {cores} threads, instructions: {sets}");
    let cure = "networks run on portable code, several times slower: use a processor with AVX2";
    let fast = sets.contains("avx2") && sets.contains("fma");
    Finding::good("processor", found).unless(fast, Health::Fair, cure)
}

fn the_memory() -> Finding {
    if let Err(limit) = memory::check_environments(1) {
        return Finding::bad("memory", &limit.to_string(), "raise the limit of this process");
    }
    let Some(free) = memory::available() else {
        return Finding::good("memory", "unknown");
    };
    let found = format!("{:.1} GiB free", free as f64 / f64::from(1 << 30));
    let found = Finding::good("memory", found);
    let cure = "a run of COVERS takes up to 1 GiB: close other programs";
    let replays = "enough for COVERS; a full replay (clear, 3rl, equi-sac) takes 3 GiB more";
    found.unless(free >= MEMORY + REPLAY, Health::Fair, replays).unless(
        free >= MEMORY,
        Health::Bad,
        cure,
    )
}

fn the_disk(runs: &Path) -> Finding {
    match free_disk(runs) {
        Ok(free) => {
            let (gibibytes, rooms) = (free as f64 / f64::from(1 << 30), free / RUN);
            let runs = runs.display();
            let found = format!("{gibibytes:.1} GiB free for `{runs}`, room for {rooms} full runs");
            let cure = "a full run with its checkpoints takes up to 0.125 GiB: make room, or name a \
                folder on another disk (`covers train --runs DIR`)";
            Finding::good("disk", found).unless(free >= RUN, Health::Bad, cure)
        }
        Err(error) => Finding::bad(
            "disk",
            &format!("{}: {error}", runs.display()),
            "name a folder that can be written to, for runs to go to (`covers train --runs DIR`)",
        ),
    }
}

/// Bytes that files may still take on the disk of a folder or, where it does not exist yet, of the
/// one that it would be in.
fn free_disk(folder: &Path) -> std::io::Result<u64> {
    let absolute = std::path::absolute(folder)?;
    let mut folders = absolute.ancestors();
    let there = folders.find(|folder| folder.exists());
    let there = there.unwrap_or(&absolute);
    if !there.is_dir() {
        return Err(std::io::ErrorKind::NotADirectory.into());
    }
    rustix::fs::access(there, rustix::fs::Access::WRITE_OK)?;
    let disk = rustix::fs::statvfs(there)?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

fn the_simulator() -> Finding {
    let version = envs::mujoco::version();
    let cure = format!(
        "figures are of MuJoCo {MUJOCO}: `make deps` installs it, where the system has that version"
    );
    let known = version == MUJOCO;
    Finding::good("simulator", format!("MuJoCo {version}")).unless(known, Health::Fair, cure)
}

fn the_pictures() -> Finding {
    match time_pictures() {
        Ok(time) => {
            let renderer = envs::mujoco::opengl().unwrap_or("unknown");
            let milliseconds = time.as_secs_f64() * 1e3;
            let size = camera().drawn_size();
            let found = format!("{milliseconds:.2} ms for one of {size} x {size} by {renderer}");
            Finding::good("pictures", found)
        }
        Err(error) => Finding::bad(
            "pictures",
            &error,
            "install EGL or OSMesa (`make deps` does), or start inside a session with a display",
        ),
    }
}

/// That of a run of COVERS.
fn camera() -> Camera {
    Budget::Full.experiment(Method::Covers).envs.camera
}

/// The time that a picture of Drawer Close takes as learners see it, the median of some.
fn time_pictures() -> Result<Duration, EnvError> {
    let camera = camera();
    let scene = Scene::new(TaskGroup::DRAWER_CLOSE, Embodiment::default(), camera)?;
    let scene = Arc::new(scene);
    let mut renderer = SceneRenderer::new(Arc::clone(&scene))?;
    let mut table = TableTop::new(scene, envs::Control::default())?;
    table.reset(D2::Identity, &mut ChaCha8Rng::seed_from_u64(0))?;
    let mut picture = vec![0; camera.size * camera.size * RGB];
    let mut times = Vec::new();
    for _ in 0..PICTURES {
        let clock = Instant::now();
        renderer.render(&mut table, &mut picture)?;
        times.push(clock.elapsed());
    }
    times.sort_unstable();
    Ok(times[times.len() / 2])
}

fn the_learning(threads: usize) -> Finding {
    let experiment = Budget::Full.experiment(Method::Covers);
    match time_learning(experiment.with_threads(threads)) {
        Ok(rate) => {
            let found = format!("{rate:.0} decisions of COVERS a second on {threads} threads");
            Finding::good("learning", found)
        }
        Err(error) => {
            let cure = "cure what is bad above; a run also needs a folder for temporary files";
            Finding::bad("learning", &error, cure)
        }
    }
}

/// Decisions a second in Goal Reach, those of the second turn, collected and learnt.
fn time_learning(mut experiment: Experiment) -> Result<f64, RunError> {
    let name = TaskGroup::GOAL_REACH.name();
    experiment.schedule.groups.retain(|plan| plan.group == name);
    experiment.schedule.cycles = 1;
    experiment.evaluation.visit_rounds = 0;
    let scratch = Scratch::new()?;
    let mut run = Run::start(experiment, RunFolder::open(&scratch.0))?;
    run.advance()?;
    let (clock, before) = (Instant::now(), run.ledger().decisions);
    run.advance()?;
    // a turn in doubt collects twice
    let decisions = run.ledger().decisions - before;
    Ok(decisions as f64 / clock.elapsed().as_secs_f64())
}

/// A folder of this process's own, gone with the value.
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> Result<Self, RunError> {
        let path = std::env::temp_dir().join(format!("covers-doctor-{}", std::process::id()));
        fs::create_dir_all(&path).map_err(|error| RunError::write(&path, error))?;
        Ok(Self(path))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_is_told_with_its_cure() {
        let found = Finding::good("memory", "0.5 GiB free");
        assert_eq!(found.line(), "ok    memory     0.5 GiB free");
        let fair = found.unless(false, Health::Fair, "close others");
        let bad = fair.clone().unless(false, Health::Bad, "buy some");
        assert_eq!(fair.clone().unless(true, Health::Bad, "buy some"), fair);
        let (said, under) = bad.line().split_once('\n').map_or_else(
            || panic!("{}", bad.line()),
            |(said, under)| (said.to_owned(), under.trim().to_owned()),
        );
        assert_eq!(said, "BAD   memory     0.5 GiB free");
        assert_eq!(under, "buy some");
    }

    #[test]
    fn this_machine_simulates_draws_and_learns() {
        for part in [the_simulator(), the_pictures()] {
            assert_eq!(part.health, Health::Good, "{part:?}");
        }
        let mut experiment = Budget::Smoke.experiment(Method::Covers);
        assert!(time_learning(experiment.clone()).unwrap() > 0.0);
        experiment.envs.num_envs = 0;
        assert!(time_learning(experiment).is_err());
    }

    #[test]
    fn the_disk_of_a_folder_that_is_to_come_is_that_of_its_parent() {
        let there = std::env::temp_dir();
        let to_come = there.join("covers-doctor-to-come").join("runs");
        assert!(free_disk(&there).unwrap() > 0);
        let file = Path::new(env!("CARGO_MANIFEST_PATH"));
        assert_eq!(the_disk(file).health, Health::Bad, "a file is no folder");
        assert_eq!(the_disk(&to_come).part, "disk");
        assert!(the_disk(&to_come).found.contains("covers-doctor-to-come"));
        // a file system without room
        let full = the_disk(Path::new("/proc/self"));
        assert_eq!(full.health, Health::Bad, "{full:?}");
        assert!(full.cure.is_some_and(|cure| cure.contains("--runs")));
    }

    #[cfg(feature = "wgpu")]
    #[test]
    fn every_adapter_is_listed_and_software_is_only_fair() {
        let (found, adapters) = (the_gpus(), rl::gpu::adapters());
        let any = adapters.iter().any(|adapter| adapter.kind.is_hardware());
        assert_eq!(found.len(), adapters.len().max(1));
        for (finding, adapter) in found.iter().zip(adapters) {
            assert_eq!((finding.part, &finding.found), ("gpu", &adapter.to_string()));
            let good = finding.health == Health::Good;
            assert_eq!(good, any, "{adapter}: {finding:?}");
        }
    }
}
