//! The subcommands of `covers` that train, go on, evaluate and pack.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use envs::{Embodiment, TaskRegistry};

use crate::cli::{Threads, TrainOptions};
use crate::error::CoversError;
use crate::evaluation::Evaluator;
use crate::groupings::Labels;
use crate::learners::Extent;
use crate::run::{Run, thread_pool};
use crate::run_folder::RunFolder;
use crate::stream::Stream;
use crate::tables::{rollout_line, score_table, summary_table};

/// What `covers` does with learners.
#[derive(Clone, Debug, Subcommand)]
pub enum Command {
    /// Learns from a stream; the run's folder receives settings, metrics, scores and checkpoints.
    Train(TrainOptions),
    /// Goes on from the last checkpoint of an interrupted run.
    Resume(ResumeOptions),
    /// Scores the policies of a run on all 16 variants; which policy acts is the learner's own
    /// choice.
    Eval(EvalOptions),
    /// Copies what acting takes into a small folder: settings, policies, and some first frames of
    /// each group.
    Pack(PackOptions),
}

/// What to go on with.
#[derive(Clone, Debug, Args)]
pub struct ResumeOptions {
    /// The run's folder.
    pub run: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub threads: Threads,
    /// Print the summary as one JSON object in the last line.
    #[arg(long)]
    pub json: bool,
}

/// What to score.
#[derive(Clone, Debug, Args)]
pub struct EvalOptions {
    /// The folder of a run, or one that `covers pack` made.
    pub run: PathBuf,
    /// Episodes of each group, at least: its four variants take equal parts, and every environment
    /// the same number.
    #[arg(long, default_value_t = 100)]
    pub episodes: usize,
    /// Seed of the episodes (default: that of the run's own evaluations).
    #[arg(long)]
    pub seed: Option<u64>,
    /// What carries the gripper (default: as in the run).
    #[arg(long)]
    pub embodiment: Option<Embodiment>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub threads: Threads,
    /// Print one JSON array of the scores of all variants instead of a table.
    #[arg(long)]
    pub json: bool,
}

/// What to pack.
#[derive(Clone, Debug, Args)]
pub struct PackOptions {
    /// The run's folder.
    pub run: PathBuf,
    /// The folder to create.
    pub folder: PathBuf,
    /// First frames kept for each policy, in episodes.
    #[arg(long, default_value_t = 40)]
    pub episodes: usize,
}

impl Command {
    /// Runs the command and prints to `out`.
    ///
    /// # Errors
    /// What any part says, or an `out` that cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<(), CoversError> {
        match self {
            Self::Train(options) => train(options, out),
            Self::Resume(options) => {
                let mut run = Run::resume(&options.run, Some(options.threads.count()))?;
                finish(&mut run, options.json, out)
            }
            Self::Eval(options) => evaluate(options, out),
            Self::Pack(options) => pack(options, out),
        }
    }
}

fn train(options: &TrainOptions, out: &mut impl Write) -> Result<(), CoversError> {
    let experiment = options.experiment()?;
    experiment.check(&TaskRegistry::standard())?;
    let name = options.run_name(&experiment);
    let folder = RunFolder::create(&options.output.runs, &name)?;
    let mut run = Run::start(experiment, folder)?;
    finish(&mut run, options.output.json, out)
}

fn finish(run: &mut Run, json: bool, out: &mut impl Write) -> Result<(), CoversError> {
    while let Some(progress) = run.advance()? {
        say(out, &rollout_line(&progress))?;
        if !progress.scores.is_empty() {
            say(out, &score_table(&progress.scores))?;
        }
    }
    let summary = run.summary()?;
    say(out, &summary_table(&summary))?;
    say(out, &format!("files: {}", run.folder().path().display()))?;
    if json {
        say(out, &serde_json::json!(summary).to_string())?;
    }
    Ok(())
}

fn evaluate(options: &EvalOptions, out: &mut impl Write) -> Result<(), CoversError> {
    let folder = RunFolder::open(&options.run);
    let mut experiment = folder.experiment()?.with_threads(options.threads.count());
    experiment.envs.embodiment = options.embodiment.unwrap_or(experiment.envs.embodiment);
    let spec = Stream::spec_of(&experiment.envs);
    let labels = Labels::default();
    let learner = &experiment.learner;
    let (mut learner, _) = learner.load(&folder.checkpoint(), &spec, &labels)?;
    let seed = options.seed.unwrap_or_else(|| experiment.evaluation_seed());
    let (envs, tasks) = (experiment.envs, TaskRegistry::standard());
    let mut evaluator = Evaluator::new(envs, &tasks, experiment.schedule, seed, labels)?;
    let rounds = options.episodes.div_ceil(4 * envs.num_envs);
    let pool = thread_pool(envs.threads)?;
    let scores = pool.install(|| evaluator.all(&mut *learner, rounds))?;
    if options.json {
        say(out, &serde_json::json!(scores).to_string())
    } else {
        say(out, &score_table(&scores))
    }
}

fn pack(options: &PackOptions, out: &mut impl Write) -> Result<(), CoversError> {
    let from = RunFolder::open(&options.run);
    let experiment = from.experiment()?;
    let spec = Stream::spec_of(&experiment.envs);
    let labels = Labels::default();
    let learner = &experiment.learner;
    let (learner, note) = learner.load(&from.checkpoint(), &spec, &labels)?;
    let to = RunFolder::create_exactly(&options.folder)?;
    to.write_experiment(&experiment)?;
    let episodes = options.episodes;
    learner.save(&to.checkpoint(), Extent::Policies { episodes }, &note)?;
    say(
        out,
        &format!("{} policies in {}", learner.policies(), to.path().display()),
    )
}

fn say(out: &mut impl Write, line: &str) -> Result<(), CoversError> {
    writeln!(out, "{line}").map_err(|error| CoversError::write(Path::new("standard output"), error))
}
