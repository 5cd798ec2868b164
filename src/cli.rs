//! Options of the command line.

use std::io::{Write, stderr};
use std::path::PathBuf;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Parser};
use envs::Embodiment;
use experiments::cli::ThreadCountOption;
use experiments::presets::{Budget, Method};
use experiments::{Experiment, RunError, RunFolder};
use learner::DeviceChoice;
use learner::overrides::{self, SettingOverride};
use symmetry::Group;

use crate::setting_list::OverrideParser;

/// Outcome of a `covers` command that did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandOutcome {
    /// Finished command.
    Done,
    /// Run that SIGINT, SIGTERM, SIGHUP or a closed standard output stopped. It wrote a checkpoint,
    /// from which `covers resume` continues.
    Interrupted,
}

impl CommandOutcome {
    /// Returns the exit code of the process: 0, or 3 after an interruption.
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::Interrupted => 3,
        }
    }
}

/// Options for threads and machine-readable output.
#[derive(Clone, Copy, Debug, Args)]
pub struct ThreadAndJsonOptions {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub threads: ThreadCountOption,
    /// Print the results as JSON, in the last line.
    #[arg(long)]
    pub json: bool,
}

/// Options that change the settings of a preset or a file.
#[derive(Clone, Debug, Args)]
pub struct SettingsOptions {
    /// Seed of all random numbers; equal seeds give equal metrics.
    #[arg(long, allow_negative_numbers = true)]
    pub seed: Option<u64>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub threads: ThreadCountOption,
    /// Embodiment that carries the gripper: `sawyer`, `hand`, `kinova_gen3`, or an arm of yours as
    /// ARM.urdf (default: `sawyer`, or that of the settings file).
    #[arg(long, visible_alias = "robot")]
    pub embodiment: Option<Embodiment>,
    /// Symmetry group of the networks: `D2`, `D1x`, `D1y`, `C2`, or `C1` for ordinary networks of
    /// equal width (default: that of the preset).
    #[arg(long)]
    pub group: Option<Group>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub set: OverrideOptions,
}

/// Options for single fields of the settings.
#[derive(Clone, Debug, Args)]
pub struct OverrideOptions {
    /// Set a field of the settings, such as `envs.num_envs=20`; may be repeated, and the last value
    /// of a field wins.
    #[arg(
        long = "set",
        value_name = "PATH=VALUE",
        value_parser = OverrideParser,
        hide_possible_values = true
    )]
    pub overrides: Vec<SettingOverride>,
}

impl SettingsOptions {
    /// Returns `experiment` with the seed, embodiment, symmetry group and overrides that these
    /// options name, and in any case with their number of threads.
    ///
    /// # Errors
    /// [`learner::LearnerError::UnknownSetting`], [`learner::LearnerError::WrongSetting`].
    pub fn apply_to_experiment(&self, mut experiment: Experiment) -> Result<Experiment, RunError> {
        if let Some(seed) = self.seed {
            experiment = experiment.with_seed(seed);
        }
        if let Some(embodiment) = self.embodiment {
            experiment = experiment.with_embodiment(embodiment);
        }
        if let Some(group) = self.group {
            experiment = experiment.with_symmetry_group(group);
        }
        let experiment = experiment.with_threads(self.threads.count());
        // last, so that `--set` wins over the other options
        Ok(overrides::apply_overrides(&self.set.overrides, experiment)?)
    }

    /// Returns the preset of `method` under `budget` with these options. What the preset derives
    /// from the stream follows an overridden one ([`Method::adapt_to_stream`]).
    ///
    /// # Errors
    /// As [`SettingsOptions::apply_to_experiment`].
    pub fn preset_experiment(
        &self,
        budget: Budget,
        method: Method,
    ) -> Result<Experiment, RunError> {
        let run = self.apply_to_experiment(budget.preset_experiment(method))?;
        Ok(method.adapt_to_stream(run, &self.set.overrides))
    }
}

/// Options for the folder of a run and the output.
#[derive(Clone, Debug, Args)]
pub struct RunFolderOptions {
    /// Print the summary as one JSON object in the last line.
    #[arg(long)]
    pub json: bool,
    /// Folder in which the run's folder is created, with a new name.
    #[arg(long, default_value = "runs")]
    pub runs: PathBuf,
    /// Folder of the run itself, instead of a new one in `--runs`.
    #[arg(long, conflicts_with = "runs")]
    pub folder: Option<PathBuf>,
    /// Remove the run that `--folder` holds, finished or not.
    // `requires` alone does not hold beside `runs`, with which `folder` conflicts
    #[arg(long, requires = "folder", conflicts_with = "runs")]
    pub overwrite: bool,
}

impl RunFolderOptions {
    /// Creates the folder of a run: `--folder`, which may exist already, or a new one in `--runs`
    /// with this name, or with a number added if that is taken.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn create_run_folder(&self, name: &str) -> Result<RunFolder, RunError> {
        let Some(path) = &self.folder else {
            return RunFolder::create(&self.runs, name);
        };
        std::fs::create_dir_all(path).map_err(RunError::write_error_mapper(path))?;
        let folder = RunFolder::from_path(path);
        Ok(if self.overwrite { folder.allow_overwriting() } else { folder })
    }
}

/// Options for the settings and the folder of a run.
#[derive(Clone, Debug, Args)]
pub struct RunOptions {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub settings: SettingsOptions,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub run_folder: RunFolderOptions,
}

/// Trains COVERS on an unlabelled stream of table-top tasks.
#[derive(Clone, Debug, Parser)]
#[command(name = "covers", version)]
pub struct ContinualStreamExampleOptions {
    /// Length of the run.
    #[arg(long, value_enum, default_value = "short")]
    pub budget: Budget,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub run_options: RunOptions,
}

/// Options of `covers train`.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Examples:\n  covers train --budget short\n  covers train --preset equi --seed 3 \
    --set covers.ppo.gamma=0.97\n  covers train --config experiment.json --folder runs/mine"
)]
pub struct TrainOptions {
    /// Method to train.
    #[arg(long, value_enum, default_value_t, conflicts_with = "config")]
    pub preset: Method,
    /// Length of the run.
    #[arg(long, value_enum, default_value = "full", conflicts_with = "config")]
    pub budget: Budget,
    /// Settings file instead of a preset: JSON like the `experiment.json` of a run's folder.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Device of policy updates. Devices round differently, so runs on different devices diverge.
    #[arg(long, value_parser = device_parser(), default_value = "cpu")]
    pub device: DeviceChoice,
    /// Show learning curves, groups and policies, distances and the latest image on the terminal;
    /// `q` stops the run with a checkpoint.
    #[cfg(feature = "tui")]
    #[arg(long)]
    pub tui: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub run_options: RunOptions,
}

impl TrainOptions {
    /// Returns the settings of the run that these options describe.
    ///
    /// # Errors
    /// A settings file that cannot be read, an invalid override, or a missing GPU.
    pub fn experiment(&self) -> Result<Experiment, RunError> {
        let settings = &self.run_options.settings;
        let experiment = match &self.config {
            Some(path) => settings.apply_to_experiment(Experiment::read(path)?)?,
            None => settings.preset_experiment(self.budget, self.preset)?,
        };
        experiment.with_device(self.device)
    }

    /// Returns the name of the run's folder: the settings file or the method, the budget unless it
    /// is `full`, and the seed.
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

/// Returns the name of a run's folder: `stem` and the seed.
pub fn run_name(stem: &str, experiment: &Experiment) -> String {
    format!("{stem}-seed{}", experiment.learner.seed())
}

/// Returns the parser of `--device`.
pub(crate) fn device_parser() -> impl TypedValueParser<Value = DeviceChoice> {
    PossibleValuesParser::new(DeviceChoice::ALL.map(DeviceChoice::name))
        .try_map(|name| name.parse::<DeviceChoice>())
}

/// Returns the path by which this program was started, for commands that it prints.
pub(crate) fn program_name() -> String {
    let name = std::env::args_os().next();
    name.map_or_else(|| "covers".to_owned(), |name| shell_word(&name.to_string_lossy()))
}

/// Prints a line to standard error.
pub(crate) fn warn(line: &str) {
    // a closed terminal must not make the run fail
    let _ = writeln!(stderr(), "{line}");
}

/// Returns a word of a shell command, in quotes where it needs them.
pub(crate) fn shell_word(text: &str) -> String {
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"/._-".contains(&byte);
    if text.bytes().all(is_plain) && !text.is_empty() {
        return text.to_owned();
    }
    shell_quoted(text)
}

/// Returns a word of a shell command, in quotes.
pub(crate) fn shell_quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', r"'\''"))
}
