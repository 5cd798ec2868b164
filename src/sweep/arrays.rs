//! Sweeps on a cluster: array jobs whose members share nothing but a folder.

mod hyperqueue;
mod kubernetes;
mod slurm;

use std::path::Path;

use learner::DeviceChoice;

pub use kubernetes::KubernetesOptions;

/// Number of times that a failed job is tried again.
const RETRIES: usize = 3;

/// Sweep plan as an array job, each member of which runs `covers sweep` for one job of the plan.
#[derive(Clone, Copy, Debug)]
pub struct ArrayJob<'a> {
    /// Path of the plan's file for the members.
    pub plan: &'a Path,
    /// Path of the folder of runs for the members.
    pub runs: &'a Path,
    /// Number of jobs of the sweep plan.
    pub job_count: usize,
    /// Worker threads of each run; as many CPUs are requested.
    pub threads: usize,
    /// Memory that is requested for each run (MiB).
    pub memory_mib: u64,
    /// Device of policy updates; one GPU is requested for each run on `gpu`.
    pub device: DeviceChoice,
    /// Largest number of jobs that run at a time; `None` to leave it to the cluster.
    pub parallel: Option<usize>,
}

impl ArrayJob<'_> {
    /// Returns the arguments of `covers` for a member, but for the paths and the index of its job.
    fn options(&self) -> Vec<String> {
        let threads = self.threads.to_string();
        ["--threads", &threads, "--device", self.device.name()].map(str::to_owned).to_vec()
    }

    fn needs_gpu(&self) -> bool {
        self.device == DeviceChoice::Gpu
    }
}

#[cfg(test)]
fn example() -> ArrayJob<'static> {
    ArrayJob {
        plan: Path::new("/covers/o'neil/my \"plan\" $(HOME).json"),
        runs: Path::new("/covers/runs"),
        job_count: 9,
        threads: 3,
        memory_mib: 1536,
        device: DeviceChoice::Cpu,
        parallel: None,
    }
}
