//! Options of the command line.

use std::path::PathBuf;

use clap::{Args, Parser, ValueEnum};
use envs::Embodiment;
use symmetry::Group;

use crate::{CoversError, Experiment};

/// A run as it comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Preset {
    /// Seconds; shows that every part works.
    Smoke,
    /// Minutes; learns the two easy groups and tells all four apart.
    Short,
    /// About half an hour on two busy cores; every group three times.
    #[value(alias = "full")]
    Covers,
    /// As `covers`, but every group twice, and only one variant of each is learnt; the others appear in evaluations.
    ZeroShot,
}

impl Preset {
    /// The run.
    pub fn experiment(self) -> Experiment {
        match self {
            Self::Smoke => Experiment::smoke(),
            Self::Short => Experiment::short(),
            Self::Covers => Experiment::full(),
            Self::ZeroShot => Experiment::zero_shot(),
        }
    }

    /// The name as options spell it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Smoke => "smoke",
            Self::Short => "short",
            Self::Covers => "covers",
            Self::ZeroShot => "zero-shot",
        }
    }
}

/// How many threads work.
#[derive(Clone, Copy, Debug, Args)]
pub struct Threads {
    /// Worker threads (default: one a processor); results do not depend on them.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

impl Threads {
    /// The number asked for, or one a processor.
    pub fn count(self) -> usize {
        let available = || std::thread::available_parallelism().map_or(1, usize::from);
        self.threads.map_or_else(available, usize::from)
    }
}

/// What may differ from a preset.
#[derive(Clone, Debug, Args)]
pub struct Changes {
    /// Seed of everything random; equal seeds give equal metrics.
    #[arg(long)]
    pub seed: Option<u64>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub threads: Threads,
    /// What carries the gripper: `sawyer` (the presets') or `hand`.
    #[arg(long)]
    pub embodiment: Option<Embodiment>,
    /// The group that networks are equivariant under: `D2` (the presets'), `D1x`, `D1y`, `C2`, or `C1` for ordinary networks of equal width.
    #[arg(long)]
    pub group: Option<Group>,
}

impl Changes {
    /// The experiment with these changes.
    pub fn apply(&self, mut experiment: Experiment) -> Experiment {
        if let Some(seed) = self.seed {
            experiment = experiment.with_seed(seed);
        }
        if let Some(embodiment) = self.embodiment {
            experiment = experiment.with_embodiment(embodiment);
        }
        if let Some(group) = self.group {
            experiment = experiment.with_group(group);
        }
        experiment.with_threads(self.threads.count())
    }
}

/// Where results go.
#[derive(Clone, Debug, Args)]
pub struct Output {
    /// Print the summary as one JSON object in the last line.
    #[arg(long)]
    pub json: bool,
    /// Folder that the run's folder is created in.
    #[arg(long, default_value = "runs")]
    pub runs: PathBuf,
}

/// Learns from a stream of table-top tasks that nobody labels.
#[derive(Clone, Debug, Parser)]
#[command(version)]
pub struct StreamOptions {
    /// How long the run may take.
    #[arg(long, value_enum, default_value = "short")]
    pub budget: Preset,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub changes: Changes,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub output: Output,
}

/// A stream to learn from.
#[derive(Clone, Debug, Args)]
pub struct TrainOptions {
    /// A run as it comes.
    #[arg(long, value_enum, default_value = "covers", conflicts_with = "config")]
    pub preset: Preset,
    /// Settings of your own instead: a JSON file like the `experiment.json` of a run's folder.
    #[arg(long)]
    pub config: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub changes: Changes,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub output: Output,
}

impl TrainOptions {
    /// The run that these options ask for.
    ///
    /// # Errors
    /// A file of settings that cannot be read.
    pub fn experiment(&self) -> Result<Experiment, CoversError> {
        let experiment = match &self.config {
            Some(path) => Experiment::read(path)?,
            None => self.preset.experiment(),
        };
        Ok(self.changes.apply(experiment))
    }

    /// The name of the run's folder.
    pub fn run_name(&self, experiment: &Experiment) -> String {
        let stem = self.config.as_deref().and_then(|path| path.file_stem());
        let stem = stem.map(|stem| stem.to_string_lossy().into_owned());
        let stem = stem.unwrap_or_else(|| self.preset.name().to_owned());
        run_name(&stem, experiment)
    }
}

/// The name of a run's folder: what it is, and its seed.
pub fn run_name(stem: &str, experiment: &Experiment) -> String {
    format!("{stem}-seed{}", experiment.covers.seed)
}
