//! Provenance of a run's numbers: the program, its libraries, and the machine.

use std::io::ErrorKind;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use envs::Embodiment;
use envs::robots::RobotFile;

use crate::error::RunError;

/// Program, libraries and machine of one process that worked on a run: a line of JSON in the
/// folder's `provenance.jsonl`. Results never depend on it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Number of rollouts of the run that were done before the process started.
    #[serde(rename = "rollouts")]
    pub rollouts_before: usize,
    /// Start of the process in whole seconds since 1970, by the machine's clock, which may be
    /// wrong; negative before 1970.
    #[serde(rename = "started")]
    pub started_unix_s: i64,
    /// Command line of the process.
    pub command: Vec<String>,
    /// Version of the `experiments` crate.
    #[serde(rename = "version")]
    pub covers_version: String,
    /// Git commit that the program was built from; `None` if it was built outside a repository.
    pub commit: Option<String>,
    /// `true` if all tracked files were as in that commit at build time; `None` outside a
    /// repository.
    #[serde(rename = "clean")]
    pub clean_checkout: Option<bool>,
    /// Version of the MuJoCo library.
    #[serde(rename = "mujoco")]
    pub mujoco_version: String,
    /// Renderer of images, as OpenGL names it.
    pub renderer: String,
    /// Name of the CPU.
    pub processor: String,
    /// Vector instruction sets of the CPU that affect speed.
    #[serde(rename = "instructions")]
    pub instruction_sets: Vec<String>,
    /// Operating system and architecture.
    #[serde(rename = "system")]
    pub operating_system: String,
    /// Number of worker threads.
    pub threads: usize,
    /// GPU that policies were updated on; `None` for the CPU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gpu: Option<String>,
    /// Checksum of the robot as MuJoCo simulates it, if a file describes it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<String>,
}

impl Provenance {
    /// Name of the file with the provenance records in a run's folder.
    pub const FILE_NAME: &str = "provenance.jsonl";

    /// Returns the provenance of this process, which continues a run after `rollouts` rollouts.
    pub(crate) fn of_this_process(
        rollouts: usize,
        threads: usize,
        renderer: String,
        gpu: Option<&str>,
        robot: Option<String>,
    ) -> Self {
        Self {
            rollouts_before: rollouts,
            started_unix_s: seconds_since_1970(SystemTime::now()),
            command: command_line(),
            covers_version: env!("CARGO_PKG_VERSION").to_owned(),
            commit: option_env!("COVERS_COMMIT").map(str::to_owned),
            clean_checkout: option_env!("COVERS_CLEAN").map(|clean| clean == "true"),
            mujoco_version: envs::mujoco::library_version(),
            renderer,
            processor: processor_name().unwrap_or_else(|| "unknown".to_owned()),
            instruction_sets: cpu_instruction_sets(),
            operating_system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            threads,
            gpu: gpu.map(str::to_owned),
            robot,
        }
    }

    /// Reads the provenance records of a run's folder, oldest first; none for runs of older versions,
    /// which have no such file. Lines torn by a full disk or a power cut are skipped.
    ///
    /// # Errors
    /// [`RunError::Read`].
    pub fn read(folder: &Path) -> Result<Vec<Self>, RunError> {
        let path = folder.join(Self::FILE_NAME);
        let text = match std::fs::read(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
            text => text.map_err(RunError::read_error_mapper(&path))?,
        };
        let lines = text.split(|&byte| byte == b'\n');
        Ok(lines.flat_map(serde_json::from_slice).collect())
    }
}

/// Returns the CRC-32 (IEEE 802.3) of a file's bytes as eight hexadecimal digits.
pub(crate) fn crc32_hex(bytes: &[u8]) -> String {
    format!("{:08x}", crc32fast::hash(bytes))
}

/// Returns the checksum of a robot that a file describes, as MuJoCo simulates it; `None` for an
/// embodiment without a file.
///
/// # Errors
/// Errors of reading the robot.
pub(crate) fn robot_checksum(embodiment: Embodiment) -> Result<Option<String>, RunError> {
    if !RobotFile::has_supported_extension(Path::new(embodiment.name())) {
        return Ok(None);
    }
    let parts = embodiment.spec().parts()?;
    let texts: String = parts.included_files.iter().map(|(_, text)| &text[..]).collect();
    Ok(Some(crc32_hex(format!("{}{texts}", parts.mjcf).as_bytes())))
}

/// Returns the words of the command that started this process; bytes of paths that are not UTF-8
/// are replaced.
pub(crate) fn command_line() -> Vec<String> {
    std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect()
}

fn seconds_since_1970(time: SystemTime) -> i64 {
    match time.duration_since(UNIX_EPOCH) {
        Ok(after) => after.as_secs() as i64,
        Err(before) => -(before.duration().as_secs() as i64),
    }
}

/// Returns the CPU's name; `None` if the system does not report it.
pub fn processor_name() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}

/// Returns those of the vector instruction sets `avx512f`, `avx2` and `fma`, which affect speed,
/// that the CPU has.
#[cfg(target_arch = "x86_64")]
pub fn cpu_instruction_sets() -> Vec<String> {
    let sets = [
        // the networks' kernels have versions for these sets
        ("avx512f", is_x86_feature_detected!("avx512f")),
        ("avx2", is_x86_feature_detected!("avx2")),
        ("fma", is_x86_feature_detected!("fma")),
    ];
    sets.iter().filter(|(_, present)| *present).map(|(name, _)| (*name).to_owned()).collect()
}

/// Returns no instruction sets: none is detected on this architecture.
#[cfg(not(target_arch = "x86_64"))]
pub fn cpu_instruction_sets() -> Vec<String> {
    Vec::new()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_clock_before_1970_is_no_error() {
        let early = UNIX_EPOCH - Duration::from_secs(90);
        assert_eq!(seconds_since_1970(early), -90);
        assert_eq!(seconds_since_1970(UNIX_EPOCH + Duration::from_secs(90)), 90);
    }
}
