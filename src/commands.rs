//! The subcommands of `covers` that train, go on, evaluate and pack.

use std::io::{Write, stderr};
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use envs::{Embodiment, TaskRegistry, VecEnvSettings};

use crate::CoversError;
use crate::cli::{TrainOptions, Work, device};
use crate::sweep::{self, ArrayJob, Ended, Plan};
use experiments::cli::{say, thread_count};
use experiments::evaluation::Evaluator;
use experiments::text::{event_text, score_table, summary_table};
use experiments::{Event, Run, RunError, RunFolder, Stop, Stream, memory, thread_pool};
use learner::{DeviceChoice, Extent, Labels};
use report::ReportOptions;

/// What `covers` does with learners.
#[derive(Clone, Debug, Subcommand)]
pub enum Command {
    /// Learns from a stream; the run's folder receives settings, metrics, scores and checkpoints.
    Train(TrainOptions),
    /// Goes on from the newest intact checkpoint of an interrupted run.
    Resume(ResumeOptions),
    /// Runs methods times seeds; any number of workers may share the work.
    Sweep(SweepOptions),
    /// Scores the policies of a run on all 16 variants; which policy acts is the learner's own
    /// choice.
    Eval(EvalOptions),
    /// Tables of methods with intervals over seeds, and curves, from the folders of runs.
    Report(ReportOptions),
    /// Copies what acting takes into a small folder: settings, policies, and some first frames of
    /// each group.
    Pack(PackOptions),
}

/// What to go on with.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Example: covers resume runs/covers-seed0")]
pub struct ResumeOptions {
    /// The run's folder.
    pub run: PathBuf,
    /// Where policies learn from here on, which may be elsewhere than before.
    #[arg(long, value_parser = device(), default_value = "cpu")]
    pub device: DeviceChoice,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub work: Work,
}

/// Which runs to do.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Examples:\n  covers sweep plan.json --runs runs\n  covers sweep plan.json --slurm > job.sh"
)]
pub struct SweepOptions {
    /// The plan: a JSON file with `methods`, `seeds`, a `budget`, settings to `set`, and `variants`
    /// of them for a study.
    pub plan: PathBuf,
    /// Folder that the runs' folders are in, which is all that workers share.
    #[arg(long, default_value = "runs")]
    pub runs: PathBuf,
    /// Worker threads of each run; results do not depend on them.
    #[arg(long, default_value_t = 1, value_parser = thread_count())]
    pub threads: u16,
    /// Do this job alone, counted from 0; where another worker has it, wait.
    #[arg(long)]
    pub job: Option<usize>,
    /// Do nothing; print a Slurm script that does the plan as an array of jobs.
    #[arg(long, conflicts_with_all = ["job", "kubernetes"])]
    pub slurm: bool,
    /// Do nothing; print a Kubernetes job (JSON) that does the plan in containers of this image.
    /// The plan and the runs must lie on the volume that is mounted at /covers, here as there.
    #[arg(long, value_name = "IMAGE", conflicts_with = "job")]
    pub kubernetes: Option<String>,
}

/// What to score.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Examples:\n  covers eval assets/pretrained\n  covers eval runs/covers-seed0 --embodiment hand --json"
)]
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
    /// Randomise the pictures as in the run, or, where they were perfect there, as
    /// `covers-randomised` does (default: perfect pictures). Close-ups cannot be randomised.
    #[arg(long)]
    pub randomised: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub work: Work,
}

/// What to pack.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Example: covers pack runs/covers-seed0 small")]
pub struct PackOptions {
    /// The run's folder.
    pub run: PathBuf,
    /// The folder to create.
    pub folder: PathBuf,
    /// First frames kept for each policy, in episodes.
    #[arg(long, default_value_t = 40)]
    pub episodes: usize,
}

/// How a command ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All was done.
    Done,
    /// Ctrl-C, SIGTERM or SIGHUP came, or standard output was closed; a checkpoint was written, and
    /// `covers resume` goes on.
    Interrupted,
}

impl Outcome {
    /// The process's exit code: 0, or 3 after an interruption.
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::Interrupted => 3,
        }
    }
}

impl Command {
    /// Runs the command and prints to `out`.
    ///
    /// # Errors
    /// What any part says, or an `out` that cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<Outcome, CoversError> {
        match self {
            Self::Train(options) => train(options, out),
            Self::Resume(options) => {
                let threads = Some(options.work.threads.count());
                let (folder, tasks) = (RunFolder::open(&options.run), TaskRegistry::standard());
                let mut run = Run::resume_with(folder, threads, options.device, tasks)?;
                finish(&mut run, options.work.json, out)
            }
            Self::Sweep(options) => sweep(options, out),
            Self::Eval(options) => Ok(evaluate(options, out).map(|()| Outcome::Done)?),
            Self::Report(options) => Ok(options.run(out).map(|()| Outcome::Done)?),
            Self::Pack(options) => Ok(pack(options, out).map(|()| Outcome::Done)?),
        }
    }
}

fn train(options: &TrainOptions, out: &mut impl Write) -> Result<Outcome, CoversError> {
    let experiment = options.experiment()?;
    experiment.check(&TaskRegistry::standard())?;
    // before the run's folder is made
    memory::check_run(&experiment)?;
    #[cfg(feature = "tui")]
    if options.tui && !std::io::IsTerminal::is_terminal(&std::io::stdout()) {
        return Err(CoversError::NoTerminal);
    }
    let folder = options.run.output.run_folder(&options.run_name(&experiment))?;
    let mut run = Run::start(experiment, folder)?;
    #[cfg(feature = "tui")]
    if options.tui {
        watch::screen::train(&mut run)?;
        run.stop_at(Stop::on_signals()?);
        return conclude(&mut run, options.run.output.json, out);
    }
    finish(&mut run, options.run.output.json, out)
}

fn sweep(options: &SweepOptions, out: &mut impl Write) -> Result<Outcome, CoversError> {
    let jobs = Plan::read(&options.plan)?.jobs()?;
    if options.slurm || options.kubernetes.is_some() {
        say(out, &array_job(options, jobs.len())?)?;
        return Ok(Outcome::Done);
    }
    let chosen = match options.job {
        None => &jobs[..],
        Some(job) => jobs.get(job..=job).ok_or_else(|| RunError::Setting {
            name: "job",
            value: job.to_string(),
            expected: "the number of a job of the plan, counted from 0",
        })?,
    };
    let threads = usize::from(options.threads);
    let ended = sweep::work(chosen, &options.runs, threads, &Stop::on_signals()?, out)?;
    let Ended { stopped, failed } = ended;
    match (stopped, failed.is_empty()) {
        (false, true) => Ok(Outcome::Done),
        (false, false) => Err(CoversError::Jobs { failed }),
        (true, true) => Ok(Outcome::Interrupted),
        (true, false) => {
            say(out, &CoversError::Jobs { failed }.to_string())?;
            Ok(Outcome::Interrupted)
        }
    }
}

/// The plan for a cluster, as its own programs read it.
fn array_job(options: &SweepOptions, jobs: usize) -> Result<String, CoversError> {
    let array = ArrayJob {
        plan: &options.plan,
        runs: &options.runs,
        jobs,
        threads: usize::from(options.threads),
    };
    if let Some(image) = &options.kubernetes {
        return Ok(format!("{:#}", array.kubernetes(image)?));
    }
    let absolute =
        |path: &Path| std::path::absolute(path).map_err(|error| RunError::read(path, error));
    let (plan, runs) = (absolute(array.plan)?, absolute(array.runs)?);
    let program = std::env::current_exe();
    let program = program.map_err(|error| RunError::read(Path::new("covers"), error))?;
    let (plan, runs) = (&plan, &runs);
    Ok(ArrayJob { plan, runs, ..array }.slurm(&program))
}

/// Runs to the end, or to a signal, and prints every step. An output that is closed stops the run
/// as a signal does.
fn finish(run: &mut Run, json: bool, out: &mut impl Write) -> Result<Outcome, CoversError> {
    let stop = Stop::on_signals()?;
    run.stop_at(stop.clone());
    let folder = run.folder().path().display();
    say_or_stop(out, &format!("{folder}: {}", run.notice()), &stop);
    while let Some(event) = run.advance()? {
        if let Event::Rollout(progress) = &event
            && let Some(warning) = progress.warning
        {
            // the log of the run has it, too
            warn(&format!("warning: {warning}"));
        }
        // the scores after the stream stand in the summary
        if !run.is_finished() {
            say_or_stop(out, &event_text(&event), &stop);
        }
    }
    conclude(run, json, out)
}

/// Prints a line. Where nobody reads it, nobody watches the run: it stops and keeps what it has.
fn say_or_stop(out: &mut impl Write, line: &str, stop: &Stop) {
    if let Err(error) = say(out, line) {
        warn(&format!("{error}: the run stops"));
        stop.request();
    }
}

/// Prints a line to standard error.
fn warn(line: &str) {
    // a terminal that is gone reads nothing, and is no reason to fail
    let _ = writeln!(stderr(), "{line}");
}

/// Prints how a run ended that does not advance: its figures, or, where it was stopped, how to go
/// on from the checkpoint of this moment, which it writes.
///
/// # Errors
/// Errors of the run, and an `out` that the figures cannot be written to.
pub fn conclude(run: &mut Run, json: bool, out: &mut impl Write) -> Result<Outcome, CoversError> {
    let folder = run.folder().path().display().to_string();
    if run.is_finished()
        && let Some(summary) = run.summary()?
    {
        say(out, &summary_table(&summary))?;
        say(out, &format!("files: {folder}"))?;
        if json {
            say(out, &serde_json::json!(summary).to_string())?;
        }
        return Ok(Outcome::Done);
    }
    run.save()?;
    let rollouts = run.ledger().rollouts;
    // no file says where policies learn
    let device = match run.experiment().learner.gpu() {
        Some(_) => " --device gpu",
        None => "",
    };
    let ending =
        format!("stopped after {rollouts} rollouts; go on with: covers resume {folder}{device}");
    if say(out, &ending).is_err() {
        warn(&ending);
    }
    Ok(Outcome::Interrupted)
}

fn evaluate(options: &EvalOptions, out: &mut impl Write) -> Result<(), RunError> {
    let folder = RunFolder::open(&options.run);
    let mut experiment = folder.experiment()?.with_threads(options.work.threads.count());
    memory::check_environments(experiment.envs.threads)?;
    experiment.envs.embodiment = options.embodiment.unwrap_or(experiment.envs.embodiment);
    let spec = Stream::spec_of(&experiment.envs);
    let labels = Labels::default();
    let learner = &experiment.learner;
    let (mut learner, own) = folder.load_with_policies(learner, &spec, &labels)?;
    let seed = options.seed.unwrap_or_else(|| experiment.evaluation_seed());
    let envs = match options.randomised {
        true => with_randomisation(experiment.envs),
        false => experiment.envs.clean(),
    };
    let tasks = TaskRegistry::standard();
    let mut evaluator = Evaluator::new(envs, &tasks, experiment.schedule, seed, labels)?;
    let rounds = options.episodes.div_ceil(4 * envs.num_envs);
    let pool = thread_pool(envs.threads)?;
    let scores = pool.install(|| evaluator.all(&mut *learner, &own, rounds))?.scores;
    if options.work.json {
        say(out, &serde_json::json!(scores).to_string())
    } else {
        say(out, &score_table(&scores))
    }
}

/// Environments with pictures that are wrong by the amounts that they have, or by nominal ones.
fn with_randomisation(envs: VecEnvSettings) -> VecEnvSettings {
    let amounts = envs.randomisation.unwrap_or_default();
    VecEnvSettings { randomisation: Some(amounts), ..envs }
}

fn pack(options: &PackOptions, out: &mut impl Write) -> Result<(), RunError> {
    let from = RunFolder::open(&options.run);
    let experiment = from.experiment()?;
    let spec = Stream::spec_of(&experiment.envs);
    let labels = Labels::default();
    let learner = &experiment.learner;
    let learner = from.load_learner(learner, &spec, &labels)?;
    let episodes = options.episodes;
    let extent = Extent::Policies { episodes };
    let to = RunFolder::pack(&options.folder, &experiment, &*learner, extent)?;
    say(out, &format!("{} policies in {}", learner.policies(), to.path().display()))
}
