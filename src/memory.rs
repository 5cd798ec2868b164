//! Memory that a run takes, compared with the limits of its process.
//!
//! A library that cannot get memory ends the process, some without any message. A limit that is
//! too low is therefore an error before the first environment is made.

use std::fs;
use std::path::{Path, PathBuf};

use crate::error::CoversError;
use crate::experiment::Experiment;
use crate::learners::LearnerSettings;
use crate::stream::Stream;

const MEBIBYTE: u64 = 1 << 20;
/// Resident memory of a small run, measured as 0.44 GiB.
const RESIDENT: u64 = 450 * MEBIBYTE;
/// Address space of a small run with one thread, and of each further thread, which has a renderer
/// and an arena of its own. One thread ran with 0.86 GiB and failed with 0.76; 4 threads ran with
/// 1.43 GiB and failed with 1.14; 16 ran with 2.38 and failed with 1.43.
const ADDRESS_SPACE: u64 = 900 * MEBIBYTE;
const ADDRESS_SPACE_OF_THREAD: u64 = 112 * MEBIBYTE;

/// Checks that the limits of this process leave enough memory for a run.
///
/// # Errors
/// [`CoversError::Memory`].
pub(crate) fn check_run(experiment: &Experiment) -> Result<(), CoversError> {
    check(experiment.envs.threads, replay_bytes(experiment))
}

/// Checks that the limits of this process leave enough memory for one renderer.
///
/// # Errors
/// [`CoversError::Memory`].
pub(crate) fn check_rendering() -> Result<(), CoversError> {
    check(1, 0)
}

fn check(threads: usize, replay: u64) -> Result<(), CoversError> {
    let further = threads.saturating_sub(1) as u64 * ADDRESS_SPACE_OF_THREAD;
    let address_space = (ADDRESS_SPACE + further + replay, used("VmSize"));
    for (limit, (needed, used)) in [
        (resource_limit("Max address space"), address_space),
        (container_limit(), (RESIDENT + replay, 0)),
    ] {
        let Some(Limit { name, bytes }) = limit else {
            continue;
        };
        let left = bytes.saturating_sub(used);
        if left < needed {
            let [needed, left] = [needed, left].map(|bytes| bytes.div_ceil(MEBIBYTE));
            return Err(CoversError::Memory {
                needed,
                left,
                limit: name,
            });
        }
    }
    Ok(())
}

/// Bytes of the replays of an off-policy learner when the stream ends: the channels of each step's
/// image that change, three quarters of them twice while a checkpoint is unpacked.
fn replay_bytes(experiment: &Experiment) -> u64 {
    let LearnerSettings::OffPolicy(settings) = &experiment.learner else {
        return 0;
    };
    let [height, width, channels] = Stream::spec_of(&experiment.envs).image;
    let image = height * width * channels.saturating_sub(settings.still_channels);
    let groups = experiment.schedule.groups.len();
    let held = settings.capacity.saturating_mul(groups);
    let steps = held.min(experiment.schedule.total_decisions());
    let bytes = (steps as u64).saturating_mul(image as u64);
    bytes.saturating_add(bytes / 4 * 3)
}

/// Upper bound on this process's memory.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Limit {
    name: String,
    bytes: u64,
}

/// Limit of `ulimit`, by its name in the system's list; `None` without one.
fn resource_limit(name: &str) -> Option<Limit> {
    let limits = fs::read_to_string("/proc/self/limits").ok()?;
    let line = limits.lines().find_map(|line| line.strip_prefix(name))?;
    let bytes = line.split_whitespace().next()?.parse().ok()?;
    let name = "the limit of its address space (`ulimit -v`)".to_owned();
    Some(Limit { name, bytes })
}

/// Smallest limit of the control groups that this process is in, as containers and batch systems
/// set it; `None` without one.
fn container_limit() -> Option<Limit> {
    let groups = fs::read_to_string("/proc/self/cgroup").ok()?;
    let own = groups.lines().find_map(|line| line.strip_prefix("0::/"))?;
    let folder = Path::new("/sys/fs/cgroup").join(own);
    let files = folder.ancestors().map(|folder| folder.join("memory.max"));
    let limits = files.filter_map(|path| Some((file_number(&path)?, path)));
    let (bytes, path): (u64, PathBuf) = limits.min()?;
    let name = format!("the limit of its container ({})", path.display());
    Some(Limit { name, bytes })
}

fn file_number(path: &Path) -> Option<u64> {
    fs::read_to_string(path).ok()?.trim().parse().ok()
}

/// Bytes of a line of this process's status, as `VmSize`; 0 where the system does not say.
fn used(name: &str) -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    line_kibibytes(&status, name).unwrap_or(0) << 10
}

/// Bytes that programs may still take, where the system says so.
pub(crate) fn available() -> Option<u64> {
    let text = fs::read_to_string("/proc/meminfo").ok()?;
    Some(line_kibibytes(&text, "MemAvailable")? << 10)
}

/// Number in a line such as `VmSize:  1024 kB`.
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
        assert!(used("VmSize") > MEBIBYTE);
        assert!(available().is_some_and(|bytes| bytes > MEBIBYTE));
        assert_eq!(line_kibibytes("VmSize:\t  12 kB\n", "VmSize"), Some(12));
        assert_eq!(line_kibibytes("VmSizes: 12 kB\n", "VmSize"), None);
    }

    #[test]
    fn a_replay_takes_the_memory_of_its_images() {
        let mut experiment = Budget::Full.experiment(Method::Clear);
        let bytes = replay_bytes(&experiment);
        // 2.05 GB were measured with a full replay, 2.9 GB after a resumption
        assert!((2 << 30..3 << 30).contains(&bytes), "{bytes}");
        experiment.schedule.groups.truncate(1);
        experiment.schedule.groups[0].decisions = 500;
        experiment.schedule.cycles = 1;
        assert_eq!(replay_bytes(&experiment), 500 * 48 * 48 * 3 / 4 * 7);
        assert_eq!(replay_bytes(&Budget::Full.experiment(Method::Covers)), 0);
    }

    #[test]
    fn more_than_any_limit_is_named_with_what_is_left() {
        check(1, 0).unwrap();
        let limited = resource_limit("Max address space").is_some() || container_limit().is_some();
        assert_eq!(check(1, u64::MAX / 2).is_err(), limited);
    }
}
