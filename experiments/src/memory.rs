//! Memory needs of a run, compared with the limits of its process.
//!
//! A library that cannot get memory may end the process without any message. Limits are therefore
//! checked before the first environment is created.

use std::fs;
use std::path::{Path, PathBuf};

use crate::error::RunError;
use crate::experiment::Experiment;
use crate::stream::SwitchableVecEnv;
use learner::{CommonSettings, GroupingSettings, LearnerSettings};

const MEBIBYTE: u64 = 1 << 20;
/// Name of the machine's memory as a limit.
const MACHINE: &str = "the memory of this machine, beside other programs,";
/// Resident memory (bytes) of a run with one thread, without the images that it keeps, and of each
/// further thread, which has its own renderer. Measured with the budget `smoke`: 393 MiB with 1
/// thread, 583 MiB with 4, 807 MiB with 16; and 475 MiB over hours of longer runs.
const RESIDENT: u64 = 470 * MEBIBYTE;
const RESIDENT_OF_THREAD: u64 = 56 * MEBIBYTE;
const REQUEST_STEP: u64 = 256;
/// Address space (bytes) of a small run with one thread, and of each further thread, which has its
/// own renderer and allocator arena. Measured: 1 thread ran with 0.86 GiB and failed with 0.76;
/// 4 threads ran with 1.43 and failed with 1.14; 16 ran with 2.38 and failed with 1.43.
const ADDRESS_SPACE: u64 = 900 * MEBIBYTE;
const ADDRESS_SPACE_OF_THREAD: u64 = 112 * MEBIBYTE;

/// Returns the resident memory (bytes) that a run needs at most, estimated from its threads and the
/// images that it keeps.
pub fn run_memory_bytes(experiment: &Experiment) -> u64 {
    resident_bytes(experiment.envs.threads, data_bytes(experiment))
}

/// Returns the memory (MiB) to request from a batch system for a run that needs this many bytes: a
/// quarter more, since needs are estimates, rounded up to a multiple of 256.
pub fn memory_request_mib(run_memory_bytes: u64) -> u64 {
    (run_memory_bytes / 4 * 5).div_ceil(REQUEST_STEP * MEBIBYTE) * REQUEST_STEP
}

/// Formats a number of bytes in GiB, such as `1.5 GiB`.
pub fn format_gibibytes(bytes: u64) -> String {
    format!("{:.1} GiB", bytes as f64 / (1_u64 << 30) as f64)
}

/// Checks that the machine and the limits of this process leave enough memory for a run.
///
/// # Errors
/// [`RunError::NotEnoughMemory`].
pub fn check_run_memory(experiment: &Experiment) -> Result<(), RunError> {
    check(experiment.envs.threads, data_bytes(experiment))
}

/// Checks that the machine and the limits of this process leave enough memory for environments on
/// `threads` threads.
///
/// # Errors
/// [`RunError::NotEnoughMemory`].
pub fn check_environment_memory(threads: usize) -> Result<(), RunError> {
    check(threads, 0)
}

fn check(threads: usize, data: u64) -> Result<(), RunError> {
    let further_threads = threads.saturating_sub(1) as u64 * ADDRESS_SPACE_OF_THREAD;
    if let Some(limit) = address_space_limit() {
        limit.check((ADDRESS_SPACE + further_threads).saturating_add(data))?;
    }
    // containers and machines limit resident memory instead of address space
    let needed = resident_bytes(threads, data);
    let machine =
        available_machine_memory_bytes().map(|left| Limit { name: MACHINE.to_owned(), left });
    let mut limits = container_limit().into_iter().chain(machine);
    limits.try_for_each(|limit| limit.check(needed))
}

fn resident_bytes(threads: usize, data: u64) -> u64 {
    let further_threads = threads.saturating_sub(1) as u64 * RESIDENT_OF_THREAD;
    (RESIDENT + further_threads).saturating_add(data)
}

/// Returns the bytes of a run's rollout, of its replay buffers and of the first frames that it
/// keeps.
fn data_bytes(experiment: &Experiment) -> u64 {
    let image: usize = SwitchableVecEnv::env_spec(&experiment.envs).image_shape.iter().product();
    let rollout = (experiment.learner.rollout_steps() as u64).saturating_mul(image as u64);
    let frames = (num_first_frames(experiment) as u64).saturating_mul(image as u64);
    rollout.saturating_add(replay_bytes(experiment)).saturating_add(frames)
}

/// Returns the number of first frames that all policies keep at the end of the stream.
fn num_first_frames(experiment: &Experiment) -> usize {
    let CommonSettings { first_frames, buffer_episodes, .. } = experiment.learner.common();
    let of_all = |each: usize| each.saturating_mul(num_policies(experiment));
    let most = buffer_episodes.map_or(usize::MAX, of_all);
    let decisions = experiment.schedule.total_decisions();
    let episodes = decisions / experiment.envs.control.decisions_per_episode().max(1);
    episodes.min(most).saturating_mul(first_frames)
}

/// Returns the expected number of policies, one for each task group but for a single one.
fn num_policies(experiment: &Experiment) -> usize {
    match experiment.learner.grouping() {
        GroupingSettings::Single => 1,
        _ => experiment.schedule.groups.len(),
    }
}

/// Returns the bytes of an off-policy learner's replay buffers at the end of the stream: the
/// changing image channels of each step, three quarters of them twice while a checkpoint is
/// unpacked.
fn replay_bytes(experiment: &Experiment) -> u64 {
    let LearnerSettings::OffPolicy(settings) = &experiment.learner else {
        return 0;
    };
    let [height, width, channels] = SwitchableVecEnv::env_spec(&experiment.envs).image_shape;
    let image = height * width * channels.saturating_sub(settings.still_channels);
    let held = settings.capacity.saturating_mul(num_policies(experiment));
    let steps = held.min(experiment.schedule.total_decisions());
    let bytes = (steps as u64).saturating_mul(image as u64);
    bytes.saturating_add(bytes / 4 * 3)
}

/// Upper bound on this process's memory that the operating system sets.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Limit {
    name: String,
    /// Number of bytes that the process may take; of a container's limit all of it, although other
    /// processes of the container may use a part.
    left: u64,
}

impl Limit {
    fn check(self, needed: u64) -> Result<(), RunError> {
        if needed <= self.left {
            return Ok(());
        }
        Err(RunError::NotEnoughMemory {
            needed_mib: needed.div_ceil(MEBIBYTE),
            left_mib: self.left / MEBIBYTE,
            limit: self.name,
        })
    }
}

/// Returns the limit of `ulimit -v`; `None` without one.
fn address_space_limit() -> Option<Limit> {
    let limits = fs::read_to_string("/proc/self/limits").ok()?;
    let mut lines = limits.lines();
    let line = lines.find_map(|line| line.strip_prefix("Max address space"))?;
    let bytes: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(Limit {
        name: "the limit of its address space (`ulimit -v`)".to_owned(),
        left: bytes.saturating_sub(used()),
    })
}

/// Returns the smallest memory limit of this process's control groups, which containers and batch
/// systems set; `None` without one.
fn container_limit() -> Option<Limit> {
    let groups = fs::read_to_string("/proc/self/cgroup").ok()?;
    smallest_limit(&groups, |path| fs::read_to_string(path).ok())
}

/// Returns the smallest limit of control groups of version 2 (a line `0::/path`) and version 1
/// (`N:memory:/path`), including those of their parents.
fn smallest_limit(groups: &str, read: impl Fn(&Path) -> Option<String>) -> Option<Limit> {
    let files = groups.lines().flat_map(|line| {
        let mut parts = line.splitn(3, ':').skip(1);
        let (kind, path) = (parts.next().unwrap_or(""), parts.next().unwrap_or(""));
        let (root, file) = match kind {
            "" => ("/sys/fs/cgroup", "memory.max"),
            "memory" => ("/sys/fs/cgroup/memory", "memory.limit_in_bytes"),
            _ => return Vec::new(),
        };
        let folder = Path::new(root).join(path.trim_start_matches('/'));
        let folders = folder.ancestors().take_while(|parent| parent.starts_with(root));
        folders.map(|parent| parent.join(file)).collect()
    });
    // files without a limit hold the word `max`, which does not parse
    let limit = |path: PathBuf| Some((read(&path)?.trim().parse::<u64>().ok()?, path));
    let (left, path) = files.filter_map(limit).min()?;
    let name = format!("the limit of its container ({})", path.display());
    Some(Limit { name, left })
}

/// Returns the bytes of this process's address space; 0 if the system does not report them.
fn used() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    line_kibibytes(&status, "VmSize").unwrap_or(0) << 10
}

/// Returns the memory (bytes) that programs can still take on this machine, free swap space
/// included; `None` if the system does not report it.
pub fn available_machine_memory_bytes() -> Option<u64> {
    available(&fs::read_to_string("/proc/meminfo").ok()?)
}

fn available(meminfo: &str) -> Option<u64> {
    let swap = line_kibibytes(meminfo, "SwapFree").unwrap_or(0);
    Some((line_kibibytes(meminfo, "MemAvailable")? + swap) << 10)
}

/// Returns the number in a line such as `VmSize:  1024 kB`.
fn line_kibibytes(text: &str, name: &str) -> Option<u64> {
    let rest = text.lines().find_map(|line| line.strip_prefix(name))?;
    rest.strip_prefix(':')?.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::presets::{Budget, Method};

    #[test]
    fn the_system_says_what_is_used_and_free() {
        assert!(used() > MEBIBYTE);
        assert!(available_machine_memory_bytes().is_some_and(|bytes| bytes > MEBIBYTE));
        assert_eq!(line_kibibytes("VmSize:\t  12 kB\n", "VmSize"), Some(12));
        assert_eq!(line_kibibytes("VmSizes: 12 kB\n", "VmSize"), None);
        let meminfo = "MemFree: 1 kB\nMemAvailable: 5 kB\nSwapFree: 2 kB\n";
        assert_eq!(available(meminfo), Some(7 << 10));
    }

    #[test]
    fn a_replay_takes_the_memory_of_its_images() {
        let mut experiment = Budget::TableProtocol.preset_experiment(Method::Clear);
        let bytes = replay_bytes(&experiment);
        // 2.05 GB were measured of the program with a full replay, 2.9 GB after a resumption
        assert!(((2 << 30)..(3 << 30)).contains(&bytes), "{bytes}");
        experiment.schedule.cycles *= 10;
        let longer = replay_bytes(&experiment);
        assert!(longer < bytes / 10 * 11, "one replay holds no more: {longer}");
        experiment.schedule.groups.truncate(1);
        experiment.schedule.groups[0].decisions = 500;
        experiment.schedule.cycles = 1;
        assert_eq!(replay_bytes(&experiment), 500 * 48 * 48 * 3 / 4 * 7);
        assert_eq!(replay_bytes(&Budget::Full.preset_experiment(Method::Covers)), 0);
    }

    /// The paper's settings keep the first frames of all episodes.
    #[test]
    fn first_frames_take_the_memory_of_their_images() {
        let mut experiment = Budget::Smoke.preset_experiment(Method::Paper);
        let episodes =
            experiment.schedule.total_decisions() / experiment.envs.control.decisions_per_episode();
        let frames = experiment.learner.common().first_frames;
        assert_eq!(num_first_frames(&experiment), episodes * frames);
        if let LearnerSettings::Covers(settings) = &mut experiment.learner {
            settings.buffer_episodes = Some(1);
        }
        assert_eq!(num_first_frames(&experiment), experiment.schedule.groups.len() * frames);
    }

    #[test]
    fn needs_are_above_what_was_measured_and_grow_with_threads_and_images() {
        let smoke = Budget::Smoke.preset_experiment(Method::Covers);
        let mib = |experiment: Experiment| run_memory_bytes(&experiment) / MEBIBYTE;
        for (threads, measured) in [(1, 393), (4, 583), (16, 807)] {
            let needed = mib(smoke.clone().with_threads(threads));
            assert!((measured..2 * measured).contains(&needed), "{threads}: {needed}");
        }
        // 475 MiB were measured over hours
        let full = Budget::Full.preset_experiment(Method::Covers).with_threads(1);
        assert!((475..600).contains(&mib(full.clone())), "{}", mib(full));
        assert_eq!(memory_request_mib(400 * MEBIBYTE), 512);
        assert_eq!(memory_request_mib(410 * MEBIBYTE), 768);
        assert_eq!(format_gibibytes(1536 * MEBIBYTE), "1.5 GiB");
    }

    #[test]
    fn a_limit_that_is_too_low_is_named_with_what_is_left_and_needed() {
        let limit = Limit { name: "the limit".to_owned(), left: 5 * MEBIBYTE + 7 };
        limit.clone().check(5 * MEBIBYTE + 7).unwrap();
        let message = limit.check(5 * MEBIBYTE + 8).unwrap_err().to_string();
        assert!(
            message.contains("the limit leaves 5 MiB, and about 6 MiB of memory are needed"),
            "{message}"
        );
    }

    #[test]
    fn the_smallest_limit_of_all_control_groups_counts() {
        let read = |path: &Path| {
            let text = match path.to_str()? {
                "/sys/fs/cgroup/a/b/memory.max" => "max\n",
                "/sys/fs/cgroup/a/memory.max" => "4096\n",
                "/sys/fs/cgroup/memory/job/memory.limit_in_bytes" => "8192\n",
                _ => return None,
            };
            Some(text.to_owned())
        };
        let smallest = |groups| smallest_limit(groups, read).map(|limit| limit.left);
        assert_eq!(smallest("0::/a/b\n"), Some(4096));
        assert_eq!(smallest("8:pids:/\n3:memory:/job\n"), Some(8192));
        assert_eq!(smallest("3:memory:/job\n0::/a/b\n"), Some(4096));
        assert_eq!(smallest("8:pids:/a\n"), None);
    }
}
