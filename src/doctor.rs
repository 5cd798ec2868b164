//! `covers doctor`: a check of this machine's hardware, libraries and speed, with fixes for
//! problems.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Args;
use envs::mujoco::{REFERENCE_RELEASE, is_reference_release, library_version};
use envs::{Camera, Embodiment, EnvError, RGB_CHANNELS, Scene, SceneRenderer, TableTop, TaskGroup};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use symmetry::D2;

use crate::cli::ThreadAndJsonOptions;
use experiments::presets::{Budget, Method};
use experiments::{
    Experiment, Run, RunError, RunFolder, cpu_instruction_sets, memory, processor_name,
};

/// Number of images in the measurement of rendering.
const PICTURES: u32 = 100;
/// Disk space that a run with the budget `full` needs (bytes), with a margin: its tables, the kept
/// checkpoints and the one that is being written. Measured: 144 to 173 MB for `covers-sac` with
/// three checkpoints of 47 to 65 MB, 26 MB for `covers`, 39 MB for ordinary networks.
const RUN: u64 = 256 << 20;

/// Options of `covers doctor`.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Examples:\n  covers doctor\n  covers doctor --runs /data/runs --json")]
pub struct DoctorOptions {
    /// Folder that runs would be written to; it need not exist yet.
    #[arg(long, default_value = "runs")]
    pub runs: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub threads_and_json: ThreadAndJsonOptions,
}

/// State of a part of the machine, as `covers doctor` judges it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum MachineHealth {
    /// Part that works well.
    Good,
    /// Part that works, but could be better.
    Fair,
    /// Part that does not work.
    Bad,
}

/// Result of the check of one part of the machine.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MachineCheckResult {
    /// Name of the part that was checked.
    pub part: &'static str,
    /// State of the part that was checked.
    pub health: MachineHealth,
    /// Description of what the check found in the part.
    #[serde(rename = "found")]
    pub description: String,
    /// Way to fix or improve the part; `None` if it works well.
    #[serde(rename = "cure")]
    pub fix: Option<String>,
}

impl MachineCheckResult {
    fn good(part: &'static str, found: impl Into<String>) -> Self {
        Self { part, health: MachineHealth::Good, description: found.into(), fix: None }
    }

    fn bad(part: &'static str, error: &impl std::fmt::Display, fix: &str) -> Self {
        Self::good(part, error.to_string()).unless(false, MachineHealth::Bad, fix)
    }

    /// Returns this finding if all is `well`; otherwise one with this health and this fix.
    fn unless(self, well: bool, health: MachineHealth, fix: impl Into<String>) -> Self {
        if well { self } else { Self { health, fix: Some(fix.into()), ..self } }
    }

    fn line(&self) -> String {
        let Self { part, description, fix, .. } = self;
        let mark = match self.health {
            MachineHealth::Good => "ok",
            MachineHealth::Fair => "fair",
            MachineHealth::Bad => "BAD",
        };
        let fix = fix.iter().map(|fix| format!("\n{:17}{fix}", ""));
        format!("{mark:<4}  {part:<9}  {description}{}", fix.collect::<String>())
    }
}

impl DoctorOptions {
    /// Checks this machine, prints the findings, and returns `true` if everything works.
    ///
    /// # Errors
    /// An `out` that cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<bool, RunError> {
        let findings = check_machine(self.threads_and_json.threads.count(), &self.runs);
        let text = if self.threads_and_json.json {
            serde_json::json!(findings).to_string()
        } else {
            findings.iter().map(MachineCheckResult::line).collect::<Vec<_>>().join("\n")
        };
        writeln!(out, "{text}")
            .map_err(RunError::write_error_mapper(Path::new("standard output")))?;
        Ok(findings.iter().all(|found| found.health != MachineHealth::Bad))
    }
}

/// Checks this machine part by part, and returns a finding for each; rendering and training are
/// left out where memory is too short for them. Training is measured on this many threads; `runs`
/// is the folder that runs would be written to.
pub fn check_machine(threads: usize, runs: &Path) -> Vec<MachineCheckResult> {
    let memory = check_memory(threads);
    // rendering libraries that find no memory would end the process, and with it the report
    let may_draw = memory::check_environment_memory(threads).is_ok();
    let mut others = vec![memory, check_disk(runs), check_simulator()];
    if may_draw {
        others.extend([check_pictures(), check_learning(threads)]);
    }
    [vec![check_cpu()], check_gpus(), others].concat()
}

/// Returns a finding for each GPU that can update policies; empty without the feature `wgpu`.
#[cfg(feature = "wgpu")]
fn check_gpus() -> Vec<MachineCheckResult> {
    let adapters = rl::gpu::available_gpu_adapters();
    let fix =
        "policies are updated on the CPU: install the Vulkan driver of a GPU, if there is one";
    if adapters.is_empty() {
        let none = MachineCheckResult::good("gpu", "no Vulkan driver");
        return vec![none.unless(false, MachineHealth::Fair, fix)];
    }
    // a software adapter beside a real GPU is no reason to install a driver
    let any_hardware = adapters.iter().any(|adapter| adapter.kind.is_hardware());
    adapters
        .iter()
        .map(|adapter| MachineCheckResult::good("gpu", adapter.to_string()))
        .map(|finding| finding.unless(any_hardware, MachineHealth::Fair, fix))
        .collect()
}

#[cfg(not(feature = "wgpu"))]
fn check_gpus() -> Vec<MachineCheckResult> {
    Vec::new()
}

fn check_cpu() -> MachineCheckResult {
    let name = processor_name().unwrap_or_else(|| "unknown".to_owned());
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let sets = cpu_instruction_sets().join(", ");
    let found = format!("{name}, {cores} threads, instructions: {sets}");
    let fix = "networks run on portable code, several times slower: use a CPU with AVX2";
    let fast = sets.contains("avx2") && sets.contains("fma");
    MachineCheckResult::good("CPU", found).unless(fast, MachineHealth::Fair, fix)
}

fn check_memory(threads: usize) -> MachineCheckResult {
    if let Err(limit) = memory::check_environment_memory(1) {
        return MachineCheckResult::bad(
            "memory",
            &limit.to_string(),
            "raise the limit of this process",
        );
    }
    let Some(free) = memory::available_machine_memory_bytes() else {
        return MachineCheckResult::good("memory", "unknown");
    };
    let needs = |method: Method| {
        memory::run_memory_bytes(&Budget::Full.preset_experiment(method).with_threads(threads))
    };
    let default = Method::default();
    let (needed, most) = (needs(default), Method::ALL.map(needs).into_iter().max().unwrap_or(0));
    let [free_text, needed_text, most_text] = [free, needed, most].map(memory::format_gibibytes);
    let found = format!(
        "{free_text} free; a full run on {threads} threads takes {needed_text} for {}, up to \
         {most_text} for other methods",
        default.name()
    );
    MachineCheckResult::good("memory", found)
        .unless(free >= most, MachineHealth::Fair, "enough for COVERS, but not for every method")
        .unless(free >= needed, MachineHealth::Bad, "close other programs, or use fewer threads")
}

fn check_disk(runs: &Path) -> MachineCheckResult {
    match free_disk(runs) {
        Ok(free) => {
            let (gibibytes, rooms) = (free as f64 / f64::from(1 << 30), free / RUN);
            let runs = runs.display();
            let found = format!("{gibibytes:.1} GiB free for `{runs}`, room for {rooms} full runs");
            let fix = "a full run with its checkpoints takes up to 0.25 GiB: make room, or name a \
                folder on another disk (`covers train --runs DIR`)";
            MachineCheckResult::good("disk", found).unless(free >= RUN, MachineHealth::Bad, fix)
        }
        Err(error) => MachineCheckResult::bad(
            "disk",
            &format!("{}: {error}", runs.display()),
            "name a folder for runs that can be written to (`covers train --runs DIR`)",
        ),
    }
}

/// Returns the free bytes on the disk of a folder. A folder that does not exist yet counts as its
/// first existing ancestor.
///
/// # Errors
/// A path that is not a folder, or one that this process may not write to.
fn free_disk(folder: &Path) -> std::io::Result<u64> {
    let absolute = std::path::absolute(folder)?;
    let existing = absolute.ancestors().find(|parent| parent.exists()).unwrap_or(&absolute);
    if !existing.is_dir() {
        return Err(std::io::ErrorKind::NotADirectory.into());
    }
    rustix::fs::access(existing, rustix::fs::Access::WRITE_OK)?;
    let disk = rustix::fs::statvfs(existing)?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

fn check_simulator() -> MachineCheckResult {
    let version = library_version();
    let fix = format!(
        "published results used MuJoCo {REFERENCE_RELEASE}: `make deps` installs it, if the system's packages \
         have that version"
    );
    MachineCheckResult::good("simulator", format!("MuJoCo {version}")).unless(
        is_reference_release(),
        MachineHealth::Fair,
        fix,
    )
}

fn check_pictures() -> MachineCheckResult {
    match time_pictures() {
        Ok(time) => {
            let renderer = envs::mujoco::opengl_description().unwrap_or("unknown");
            let milliseconds = time.as_secs_f64() * 1e3;
            let size = camera().rendered_size();
            let found = format!("{milliseconds:.2} ms for {size} x {size} pixels by {renderer}");
            MachineCheckResult::good("pictures", found)
        }
        Err(error) => MachineCheckResult::bad(
            "pictures",
            &error,
            "install EGL or OSMesa (`make deps` does), or start inside a session with a display",
        ),
    }
}

/// Returns the camera settings of a full run of COVERS.
fn camera() -> Camera {
    Budget::Full.preset_experiment(Method::default()).envs.camera
}

/// Returns the measured median time to render an observation of Drawer Close.
fn time_pictures() -> Result<Duration, EnvError> {
    let camera = camera();
    let scene = Scene::new(TaskGroup::DRAWER_CLOSE, Embodiment::default(), camera)?;
    let scene = Arc::new(scene);
    let mut renderer = SceneRenderer::new(Arc::clone(&scene))?;
    let mut table = TableTop::new(scene, envs::ControlSettings::default())?;
    table.reset(D2::Identity, &mut ChaCha8Rng::seed_from_u64(0))?;
    let mut picture = vec![0; camera.size * camera.size * RGB_CHANNELS];
    let mut times = Vec::new();
    for _ in 0..PICTURES {
        let clock = Instant::now();
        renderer.render(&mut table, &mut picture)?;
        times.push(clock.elapsed());
    }
    times.sort_unstable();
    Ok(times[times.len() / 2])
}

fn check_learning(threads: usize) -> MachineCheckResult {
    let experiment = Budget::Full.preset_experiment(Method::default());
    match time_learning(experiment.with_threads(threads)) {
        Ok(rate) => {
            let minutes = |budget: Budget| {
                let stream = budget.preset_experiment(Method::default()).schedule;
                stream.total_decisions() as f64 / rate / 60.0
            };
            let (short, full) = (minutes(Budget::Short), minutes(Budget::Full));
            let found = format!(
                "{rate:.0} decisions of COVERS per second on {threads} threads: `make stream` trains \
                 for about {short:.0} minutes, `covers train` for {full:.0}"
            );
            MachineCheckResult::good("learning", found)
        }
        Err(error) => {
            let fix = "fix what is BAD above; this test also writes to the folder for temporary \
                files, which TMPDIR names";
            MachineCheckResult::bad("learning", &error, fix)
        }
    }
}

/// Returns the measured speed of training in Goal Reach in decisions per second, over the second
/// iteration; the first one warms up.
fn time_learning(mut experiment: Experiment) -> Result<f64, RunError> {
    let name = TaskGroup::GOAL_REACH.name();
    experiment.schedule.groups.retain(|plan| plan.group == name);
    experiment.schedule.cycles = 1;
    experiment.evaluation.visit_episodes_per_env = 0;
    let scratch = Scratch::new()?;
    let mut run = Run::start(experiment, RunFolder::from_path(&scratch.0))?;
    run.advance()?;
    let (clock, before) = (Instant::now(), run.stats().decisions);
    run.advance()?;
    // the number of decisions varies: an undecided assignment collects a second rollout
    let decisions = run.stats().decisions - before;
    Ok(decisions as f64 / clock.elapsed().as_secs_f64())
}

/// Temporary folder of this process, removed on drop.
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> Result<Self, RunError> {
        let path = std::env::temp_dir().join(format!("covers-doctor-{}", std::process::id()));
        fs::create_dir_all(&path).map_err(RunError::write_error_mapper(&path))?;
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
        let found = MachineCheckResult::good("memory", "0.5 GiB free");
        assert_eq!(found.line(), "ok    memory     0.5 GiB free");
        let fair = found.unless(false, MachineHealth::Fair, "close others");
        let bad = fair.clone().unless(false, MachineHealth::Bad, "buy some");
        assert_eq!(fair.clone().unless(true, MachineHealth::Bad, "buy some"), fair);
        let (said, under) = bad.line().split_once('\n').map_or_else(
            || panic!("{}", bad.line()),
            |(said, under)| (said.to_owned(), under.trim().to_owned()),
        );
        assert_eq!(said, "BAD   memory     0.5 GiB free");
        assert_eq!(under, "buy some");
    }

    #[test]
    fn this_machine_simulates_draws_and_learns() {
        let is_reference = is_reference_release();
        let simulator = if is_reference { MachineHealth::Good } else { MachineHealth::Fair };
        assert_eq!(check_simulator().health, simulator, "{:?}", check_simulator());
        assert_eq!(check_pictures().health, MachineHealth::Good, "{:?}", check_pictures());
        let mut experiment = Budget::Smoke.preset_experiment(Method::default());
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
        assert_eq!(check_disk(file).health, MachineHealth::Bad, "a file is not a folder");
        assert!(check_disk(&to_come).description.contains("covers-doctor-to-come"));
        // a file system without room
        let full = check_disk(Path::new("/proc/self"));
        assert_eq!(full.health, MachineHealth::Bad, "{full:?}");
        assert!(full.fix.is_some_and(|fix| fix.contains("--runs")));
    }

    #[cfg(feature = "wgpu")]
    #[test]
    fn every_adapter_is_listed_and_software_is_only_fair() {
        let (found, adapters) = (check_gpus(), rl::gpu::available_gpu_adapters());
        let any = adapters.iter().any(|adapter| adapter.kind.is_hardware());
        assert_eq!(found.len(), adapters.len().max(1));
        for (finding, adapter) in found.iter().zip(adapters) {
            assert_eq!((finding.part, &finding.description), ("gpu", &adapter.to_string()));
            let good = finding.health == MachineHealth::Good;
            assert_eq!(good, any, "{adapter}: {finding:?}");
        }
    }
}
