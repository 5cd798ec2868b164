//! Options of the command line.

use std::path::PathBuf;

use clap::{Parser, ValueEnum};
use envs::Embodiment;

use crate::experiment::Experiment;

/// How long a run may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Budget {
    /// Seconds; shows that every part works.
    Smoke,
    /// Minutes; learns the two easy groups and tells all four apart.
    Short,
    /// About twenty minutes; every group three times.
    Full,
}

/// Learns from a stream of table-top tasks that nobody labels.
#[derive(Clone, Debug, Parser)]
#[command(version)]
pub struct StreamOptions {
    /// How long the run may take.
    #[arg(long, value_enum, default_value = "short")]
    pub budget: Budget,
    /// Seed of everything random; equal seeds give equal metrics.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Worker threads (default: one a processor); results do not depend on them.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// What carries the gripper: `sawyer` or `hand`.
    #[arg(long, default_value = "sawyer")]
    pub embodiment: Embodiment,
    /// Print the summary as one JSON object in the last line.
    #[arg(long)]
    pub json: bool,
    /// Folder that the run's folder is created in.
    #[arg(long, default_value = "runs")]
    pub runs: PathBuf,
}

impl StreamOptions {
    /// The run that these options ask for.
    pub fn experiment(&self) -> Experiment {
        let experiment = match self.budget {
            Budget::Smoke => Experiment::smoke(),
            Budget::Short => Experiment::short(),
            Budget::Full => Experiment::full(),
        };
        let available = || std::thread::available_parallelism().map_or(1, usize::from);
        experiment
            .with_seed(self.seed)
            .with_threads(self.threads.map_or_else(available, usize::from))
            .with_embodiment(self.embodiment)
    }

    /// The name of the run's folder.
    pub fn run_name(&self) -> String {
        let budget = match self.budget {
            Budget::Smoke => "smoke",
            Budget::Short => "short",
            Budget::Full => "full",
        };
        format!("{budget}-seed{}", self.seed)
    }
}
