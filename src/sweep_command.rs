//! `covers sweep`: works on a plan, or prints what submits it to a cluster.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{ArgGroup, Args};

use crate::CoversError;
use crate::cli::{CommandOutcome, device_parser, program_name, shell_word, warn};
use crate::sweep::{
    self, ArrayJob, KubernetesOptions, SweepJob, SweepPlan, SweepWorkerOutcome, SweepWorkerSettings,
};
use experiments::cli::{print_escaped, thread_count_parser};
use experiments::{RunError, StopSignal, memory};
use learner::DeviceChoice;

// `requires` is not checked for an option that another one excludes, so these are named, too
const NOT_SLURM: [&str; 2] = ["hyperqueue", "kubernetes"];
const NOT_KUBERNETES: [&str; 2] = ["slurm", "hyperqueue"];

/// Options of `covers sweep`.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Examples:\n  covers sweep plan.json --runs runs\n  covers sweep plan.json --slurm > job.sh && bash job.sh",
    group = ArgGroup::new("cluster").conflicts_with("job")
)]
pub struct SweepOptions {
    /// Plan: a JSON file with `methods`, `seeds`, a `budget`, settings to `set`, and `variants` of
    /// settings for a study.
    pub plan: PathBuf,
    /// Folder that holds the folders of the runs, and which all workers share.
    #[arg(long, default_value = "runs")]
    pub runs: PathBuf,
    /// Worker threads of each run; results do not depend on them.
    #[arg(long, default_value_t = 1, value_parser = thread_count_parser())]
    pub threads: u16,
    /// Device of policy updates. Devices round differently, so runs on different devices diverge.
    #[arg(long, value_parser = device_parser(), default_value = "cpu")]
    pub device: DeviceChoice,
    /// Run only the job with this index, from 0; wait if another worker runs it.
    #[arg(long)]
    pub job: Option<usize>,
    /// Take over the run of another worker whose files have not changed for this many seconds;
    /// more than its longest rollout and evaluation of all variants (default: never).
    #[arg(
        long,
        value_name = "SECONDS",
        value_parser = clap::value_parser!(u64).range(1..),
        conflicts_with = "cluster"
    )]
    pub take_over_after: Option<u64>,
    /// Print a script that submits the plan to Slurm as job arrays, and run nothing.
    #[arg(long, group = "cluster")]
    pub slurm: bool,
    /// Print a Python program that submits the plan to HyperQueue, and run nothing.
    #[arg(long = "hq", group = "cluster")]
    pub hyperqueue: bool,
    /// Print a Kubernetes job (JSON) that runs the plan in containers of this image, and run
    /// nothing. The volume with the plan and the runs must be mounted at /covers, here as in the
    /// containers.
    #[arg(long, value_name = "IMAGE", group = "cluster")]
    pub kubernetes: Option<String>,
    /// Largest number of jobs that Slurm or Kubernetes runs at a time (default: no limit in Slurm,
    /// 32 in Kubernetes).
    #[arg(long, requires = "cluster", conflicts_with = "hyperqueue",
        value_parser = clap::value_parser!(u32).range(1..))]
    pub parallel: Option<u32>,
    /// Time limit of each Slurm job, such as `90` minutes or `1-12:00:00`. A run that reaches it
    /// writes a checkpoint and is requeued.
    #[arg(long, value_name = "TIME", requires = "slurm", conflicts_with_all = NOT_SLURM,
        value_parser = time_limit)]
    pub time: Option<String>,
    /// Name of the Kubernetes job, unique in its namespace.
    #[arg(long, requires = "kubernetes", conflicts_with_all = NOT_KUBERNETES,
        default_value = "covers")]
    pub name: String,
    /// Name of the claim of the Kubernetes volume.
    #[arg(long, requires = "kubernetes", conflicts_with_all = NOT_KUBERNETES,
        default_value = "covers")]
    pub claim: String,
    /// Print a new claim of this size, such as `100Gi`, with the Kubernetes job.
    #[arg(long, value_name = "SIZE", requires = "kubernetes",
        conflicts_with_all = NOT_KUBERNETES)]
    pub claim_size: Option<String>,
}

/// Parses a time limit, of which only the form is checked: Slurm knows what it allows.
fn time_limit(text: &str) -> Result<String, &'static str> {
    let plain = |byte: u8| byte.is_ascii_digit() || byte == b':' || byte == b'-';
    if text.starts_with(|first: char| first.is_ascii_digit()) && text.bytes().all(plain) {
        return Ok(text.to_owned());
    }
    Err("expected minutes, HH:MM:SS or D-HH:MM:SS")
}

impl SweepOptions {
    /// Runs the jobs of the plan, or the one of `--job`, or prints a script, program or Kubernetes
    /// job that runs them on a cluster.
    ///
    /// # Errors
    /// An invalid plan, [`CoversError::SweepJobsFailed`], or an `out` that cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<CommandOutcome, CoversError> {
        let plan = SweepPlan::read(&self.plan)?;
        let jobs = plan.jobs()?;
        if let Some(warning) = plan.stream_warning(&jobs) {
            warn(&warning);
        }
        if self.slurm || self.hyperqueue || self.kubernetes.is_some() {
            print_escaped(out, self.array_job(&jobs)?.trim_end())?;
            return Ok(CommandOutcome::Done);
        }
        let chosen = match self.job {
            None => &jobs[..],
            Some(job) => jobs.get(job..=job).ok_or_else(|| {
                RunError::invalid(
                    "job",
                    job,
                    "the index of a job of the plan, from 0 to one less than its number of jobs",
                )
            })?,
        };
        let settings = SweepWorkerSettings {
            runs: &self.runs,
            threads: usize::from(self.threads),
            device: self.device,
            take_over_after: self.take_over_after.map(Duration::from_secs),
        };
        let ended =
            sweep::run_sweep_worker(chosen, settings, &StopSignal::from_os_signals()?, out)?;
        let SweepWorkerOutcome { stopped, failed_jobs: failed } = ended;
        match (stopped, failed.is_empty()) {
            (false, true) => {
                if self.job.is_none() {
                    let program = program_name();
                    let runs = shell_word(&self.runs.display().to_string());
                    let next = format!("next:  {program} report {runs}/* --out report --films");
                    print_escaped(out, &next)?;
                }
                Ok(CommandOutcome::Done)
            }
            (false, false) => Err(CoversError::SweepJobsFailed { failed_jobs: failed }),
            (true, true) => Ok(CommandOutcome::Interrupted),
            // the exit code says that the sweep can be continued, so failures are only printed
            (true, false) => {
                let failures = CoversError::SweepJobsFailed { failed_jobs: failed };
                print_escaped(out, &failures.to_string())?;
                Ok(CommandOutcome::Interrupted)
            }
        }
    }

    /// Returns the script or manifest that submits the plan to a cluster.
    fn array_job(&self, jobs: &[SweepJob]) -> Result<String, CoversError> {
        let threads = usize::from(self.threads);
        let needs = jobs.iter().map(|job| {
            let experiment = job.experiment.clone().with_threads(threads);
            memory::run_memory_bytes(&experiment)
        });
        let array = ArrayJob {
            plan: &self.plan,
            runs: &self.runs,
            job_count: jobs.len(),
            threads,
            memory_mib: memory::memory_request_mib(needs.max().unwrap_or(0)),
            device: self.device,
            parallel: self.parallel.map(|most| most as usize),
        };
        if let Some(image) = &self.kubernetes {
            let (name, claim) = (&self.name, &self.claim);
            let claim_size = self.claim_size.as_deref();
            let options = KubernetesOptions { image, name, claim, claim_size };
            return Ok(format!("{:#}", array.kubernetes_json(options)?));
        }
        // members of the array may start in another folder
        let absolute =
            |path: &Path| std::path::absolute(path).map_err(RunError::read_error_mapper(path));
        let (plan, runs) = (absolute(array.plan)?, absolute(array.runs)?);
        let program =
            std::env::current_exe().map_err(RunError::read_error_mapper(Path::new("covers")))?;
        let array = ArrayJob { plan: &plan, runs: &runs, ..array };
        Ok(if self.hyperqueue {
            array.hyperqueue_python_script(&program)
        } else {
            array.slurm_script(&program, self.time.as_deref())
        })
    }
}
