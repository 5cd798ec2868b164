//! Options of the command line.

use std::path::PathBuf;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Parser};
use envs::Embodiment;
use experiments::cli::Threads;
use experiments::presets::{Budget, Method};
use experiments::{Experiment, RunError, RunFolder};
use learner::DeviceChoice;
use learner::overrides::{self, Override};
use symmetry::Group;

/// How a run is worked on, and how its figures are told.
#[derive(Clone, Copy, Debug, Args)]
pub struct Work {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub threads: Threads,
    /// Print the figures as one JSON value, in the last line.
    #[arg(long)]
    pub json: bool,
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
    /// What carries the gripper: `sawyer` (the presets'), `hand` or `kinova_gen3`.
    #[arg(long)]
    pub embodiment: Option<Embodiment>,
    /// The group that networks are equivariant under: `D2`, `D1x`, `D1y`, `C2`, or `C1` for
    /// ordinary networks of equal width (default: the preset's).
    #[arg(long)]
    pub group: Option<Group>,
    /// Sets any field of the settings, as `covers.ppo.gamma=0.97`; may be given several times,
    /// after which the last one counts.
    #[arg(long, value_name = "PATH=VALUE")]
    pub set: Vec<Override>,
}

impl Changes {
    /// The experiment with these changes.
    ///
    /// # Errors
    /// [`learner::LearnerError::UnknownSetting`], [`learner::LearnerError::WrongSetting`].
    pub fn apply(&self, mut experiment: Experiment) -> Result<Experiment, RunError> {
        if let Some(seed) = self.seed {
            experiment = experiment.with_seed(seed);
        }
        if let Some(embodiment) = self.embodiment {
            experiment = experiment.with_embodiment(embodiment);
        }
        if let Some(group) = self.group {
            experiment = experiment.with_group(group);
        }
        let experiment = experiment.with_threads(self.threads.count());
        Ok(overrides::apply(&self.set, experiment)?)
    }
}

/// Where results go.
#[derive(Clone, Debug, Args)]
pub struct Output {
    /// Print the summary as one JSON object in the last line.
    #[arg(long)]
    pub json: bool,
    /// Folder that the run's folder is created in, under a name of its own.
    #[arg(long, default_value = "runs")]
    pub runs: PathBuf,
    /// The run's folder itself instead.
    #[arg(long, conflicts_with = "runs")]
    pub folder: Option<PathBuf>,
    /// Remove the run that the folder holds, finished or not.
    #[arg(long, requires = "folder")]
    pub overwrite: bool,
}

impl Output {
    /// The folder of a run of this name.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn run_folder(&self, name: &str) -> Result<RunFolder, RunError> {
        let Some(path) = &self.folder else {
            return RunFolder::create(&self.runs, name);
        };
        std::fs::create_dir_all(path).map_err(|error| RunError::write(path, error))?;
        let folder = RunFolder::open(path);
        Ok(match self.overwrite {
            true => folder.overwriting(),
            false => folder,
        })
    }
}

/// What a run differs in, and where its results go.
#[derive(Clone, Debug, Args)]
pub struct RunOptions {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub changes: Changes,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub output: Output,
}

/// Learns from a stream of table-top tasks that nobody labels.
#[derive(Clone, Debug, Parser)]
#[command(name = "covers", version)]
pub struct StreamOptions {
    /// How long the run may take.
    #[arg(long, value_enum, default_value = "short")]
    pub budget: Budget,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub run: RunOptions,
}

/// A stream to learn from.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Examples:\n  covers train --budget short\n  covers train --preset equi --seed 3 \
    --set covers.ppo.gamma=0.97\n  covers train --config experiment.json --folder runs/mine"
)]
pub struct TrainOptions {
    /// The method.
    #[arg(long, value_enum, default_value = "covers", conflicts_with = "config")]
    pub preset: Method,
    /// How long the run may take.
    #[arg(long, value_enum, default_value = "full", conflicts_with = "config")]
    pub budget: Budget,
    /// Settings of your own instead: a JSON file like the `experiment.json` of a run's folder.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Where policies learn; an update is the same but for rounding, and runs drift apart.
    #[arg(long, value_parser = device(), default_value = "cpu")]
    pub device: DeviceChoice,
    /// Draw curves, groups and policies, distances and the newest picture on the terminal; `q` ends
    /// the run with a checkpoint.
    #[cfg(feature = "tui")]
    #[arg(long)]
    pub tui: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub run: RunOptions,
}

impl TrainOptions {
    /// The run that these options ask for.
    ///
    /// # Errors
    /// A file of settings that cannot be read, or a GPU that there is not.
    pub fn experiment(&self) -> Result<Experiment, RunError> {
        let experiment = match &self.config {
            Some(path) => Experiment::read(path)?,
            None => self.budget.experiment(self.preset),
        };
        self.run.changes.apply(experiment)?.with_device(self.device)
    }

    /// The name of the run's folder: of the file of settings, or of the method, and of the budget
    /// unless it is the full one.
    pub fn run_name(&self, experiment: &Experiment) -> String {
        let file = self.config.as_deref().and_then(|path| path.file_stem());
        let stem = match (file, self.budget) {
            (Some(file), _) => file.to_string_lossy().into_owned(),
            (None, Budget::Full) => self.preset.name().to_owned(),
            (None, budget) => format!("{}-{}", self.preset.name(), budget.name()),
        };
        run_name(&stem, experiment)
    }
}

/// The name of a run's folder: what it is, and its seed.
pub fn run_name(stem: &str, experiment: &Experiment) -> String {
    format!("{stem}-seed{}", experiment.learner.seed())
}

/// Parser of `--device`.
pub(crate) fn device() -> impl TypedValueParser<Value = DeviceChoice> {
    PossibleValuesParser::new(DeviceChoice::ALL.map(DeviceChoice::name))
        .try_map(|name| name.parse::<DeviceChoice>())
}
