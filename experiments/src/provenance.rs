//! Where a run's numbers come from: the program, its libraries, and the machine.

use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use crate::error::RunError;

/// The program, its libraries and the machine of one process that worked on a run. A line of JSON
/// in the folder's `provenance.jsonl`; nothing that is computed depends on it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Rollouts that the run had behind it when the process began.
    pub rollouts: usize,
    /// When the process began, in whole seconds since 1970 by the machine's clock, which may be
    /// wrong; negative before.
    pub started: i64,
    /// The command line.
    pub command: Vec<String>,
    /// The version of this crate.
    pub version: String,
    /// The commit that the program was built from; none outside a repository.
    pub commit: Option<String>,
    /// Whether every file that git follows was as in that commit.
    pub clean: Option<bool>,
    /// The version of the MuJoCo library.
    pub mujoco: String,
    /// What draws the pictures, as OpenGL names it.
    pub renderer: String,
    /// The processor's name.
    pub processor: String,
    /// Sets of vector instructions that the processor has, of those that change speed.
    pub instructions: Vec<String>,
    /// Operating system and architecture.
    pub system: String,
    /// Worker threads.
    pub threads: usize,
    /// The GPU that policies learnt on; none where that was the processor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gpu: Option<String>,
}

impl Provenance {
    /// The name of the file in a run's folder.
    pub const FILE: &str = "provenance.jsonl";

    /// This process, before a run's rollout of this number.
    pub(crate) fn here(
        rollouts: usize,
        threads: usize,
        renderer: String,
        gpu: Option<&str>,
    ) -> Self {
        Self {
            rollouts,
            started: seconds_since_1970(SystemTime::now()),
            command: std::env::args().collect(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            commit: option_env!("COVERS_COMMIT").map(str::to_owned),
            clean: option_env!("COVERS_CLEAN").map(|clean| clean == "true"),
            mujoco: envs::mujoco::version(),
            renderer,
            processor: processor().unwrap_or_else(|| "unknown".to_owned()),
            instructions: instructions(),
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            threads,
            gpu: gpu.map(str::to_owned),
        }
    }

    /// Reads the lines of a folder, the first process first; a line that a full disk or a power cut
    /// tore is left out.
    ///
    /// # Errors
    /// [`RunError::Read`].
    pub fn read(folder: &Path) -> Result<Vec<Self>, RunError> {
        let path = folder.join(Self::FILE);
        let text = std::fs::read_to_string(&path).map_err(|e| RunError::read(&path, e))?;
        let lines = text.lines();
        Ok(lines.flat_map(serde_json::from_str).collect())
    }
}

fn seconds_since_1970(time: SystemTime) -> i64 {
    match time.duration_since(UNIX_EPOCH) {
        Ok(after) => after.as_secs() as i64,
        Err(before) => -(before.duration().as_secs() as i64),
    }
}

/// The processor's name, where the system tells it.
pub fn processor() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}

/// Sets of vector instructions that the processor has, of those that change speed.
#[cfg(target_arch = "x86_64")]
pub fn instructions() -> Vec<String> {
    let sets = [
        ("avx512f", is_x86_feature_detected!("avx512f")),
        ("avx2", is_x86_feature_detected!("avx2")),
        ("fma", is_x86_feature_detected!("fma")),
    ];
    let there = sets.iter().filter(|(_, there)| *there);
    there.map(|(name, _)| (*name).to_owned()).collect()
}

#[cfg(not(target_arch = "x86_64"))]
pub fn instructions() -> Vec<String> {
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
