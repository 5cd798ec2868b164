//! Subcommands of `covers` that train, resume, evaluate and pack learners.

use std::fs::create_dir_all;
use std::io::{Write, sink};
use std::path::PathBuf;

use clap::builder::RangedU64ValueParser;
use clap::{Args, Subcommand};
use console::{Style, Term, truncate_str};
use envs::{Embodiment, TaskRegistry, VecEnvSettings};

use crate::CoversError;
pub use crate::cli::CommandOutcome;
use crate::cli::{
    OverrideOptions, ThreadAndJsonOptions, TrainOptions, device_parser, program_name, shell_word,
    warn,
};
use crate::ranks::on_ranks;
use crate::sweep_command::SweepOptions;
use experiments::cli::{print_escaped, print_styled, progress_bar};
use experiments::evaluation::{EvaluationResults, Evaluator};
use experiments::text::{ROLLOUT_LINE_HEADER, format_run_event, run_summary_table, score_table};
use experiments::{
    Experiment, Run, RunError, RunEvent, RunFolder, StopSignal, SwitchableVecEnv,
    environment_failure_warning, memory, thread_pool,
};
use learner::disk::parent_folder;
use learner::overrides::{SettingOverride, apply_overrides, differing_settings, short_path};
use learner::{CheckpointExtent, DeviceChoice, TaskLabel};
use report::ReportOptions;
use rl::ProcessRanks;

/// Subcommands that work on learners.
#[derive(Clone, Debug, Subcommand)]
pub enum TrainingRunCommand {
    /// Trains on a stream, and writes settings, metrics, scores and checkpoints to a folder.
    Train(TrainOptions),
    /// Resumes an interrupted run from its newest intact checkpoint.
    Resume(ResumeOptions),
    /// Runs all combinations of methods and seeds; any number of workers may share them.
    Sweep(SweepOptions),
    /// Scores a run on all variants of its groups; the learner chooses the policy that acts.
    Eval(EvalOptions),
    /// Writes tables of methods with intervals over seeds, and learning curves, from runs.
    Report(ReportOptions),
    /// Copies the settings, the policies and some first frames of each group into a small folder,
    /// for evaluation and deployment.
    Pack(PackOptions),
}

/// Options of `covers resume`.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Example: covers resume runs/covers-sac-seed0")]
pub struct ResumeOptions {
    /// Folder of the run.
    #[arg(value_name = "RUN")]
    pub run_folder: PathBuf,
    /// Device of policy updates from here on, which may differ from the device before.
    #[arg(long, value_parser = device_parser(), default_value = "cpu")]
    pub device: DeviceChoice,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub threads_and_json: ThreadAndJsonOptions,
}

/// Options of `covers eval`.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Only fields of `envs` can be set, and those of `envs.randomisation` need \
        `--randomised`.\n\nExamples:\n  covers eval assets/pretrained\n  covers eval \
        runs/covers-sac-seed0 --embodiment hand --json\n  covers eval runs/covers-sac-seed0 --set \
        'envs.camera.misalignment.shift_mm=[30,0]'")]
pub struct EvalOptions {
    /// Folder of a run, or a folder that `covers pack` created.
    #[arg(value_name = "RUN")]
    pub run_folder: PathBuf,
    /// Least number of episodes of each group, rounded up so that all variants and environments
    /// play equally many.
    #[arg(long, default_value_t = 100, value_parser = episode_count())]
    pub episodes: usize,
    /// Seed of the episodes, as `evaluation.seed` in the run's settings (default: that one).
    #[arg(long, allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// Embodiment that carries the gripper (default: that of the run).
    #[arg(long, visible_alias = "robot")]
    pub embodiment: Option<Embodiment>,
    /// Randomise the images as in the run, or as `covers-randomised` does if the run did not
    /// (default: no randomisation). Close-ups cannot be randomised.
    #[arg(long)]
    pub randomised: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub set: OverrideOptions,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub threads_and_json: ThreadAndJsonOptions,
}

/// Options of `covers pack`.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Example: covers pack runs/covers-sac-seed0 --out small")]
pub struct PackOptions {
    /// Folder of the run.
    #[arg(value_name = "RUN")]
    pub run_folder: PathBuf,
    /// Folder to create; it must not exist.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Episodes whose first frames are kept for each policy.
    #[arg(long, default_value_t = 40)]
    pub episodes: usize,
}

impl TrainingRunCommand {
    /// Runs the command and prints to `out`.
    ///
    /// # Errors
    /// Errors of the command, or an `out` that cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<CommandOutcome, CoversError> {
        match self {
            Self::Train(options) => on_ranks(|ranks| train(options, ranks, out)),
            Self::Resume(options) => on_ranks(|ranks| resume(options, ranks, out)),
            Self::Sweep(options) => options.run(out),
            Self::Eval(options) => Ok(evaluate(options, out).map(|()| CommandOutcome::Done)?),
            Self::Report(options) => Ok(options.run(out).map(|()| CommandOutcome::Done)?),
            Self::Pack(options) => Ok(pack(options, out).map(|()| CommandOutcome::Done)?),
        }
    }
}

fn resume(
    options: &ResumeOptions,
    ranks: ProcessRanks,
    out: &mut impl Write,
) -> Result<CommandOutcome, CoversError> {
    let threads = Some(options.threads_and_json.threads.count());
    let folder = RunFolder::from_path(&options.run_folder).with_process_ranks(ranks);
    let mut run =
        Run::resume_with_tasks(folder, threads, options.device, TaskRegistry::with_all())?;
    finish(&mut run, options.threads_and_json.json, out)
}

fn train(
    options: &TrainOptions,
    ranks: ProcessRanks,
    out: &mut impl Write,
) -> Result<CommandOutcome, CoversError> {
    let experiment = options.experiment()?;
    experiment.check(&TaskRegistry::with_all())?;
    // before the run's folder is created, so that a refused run leaves nothing
    memory::check_run_memory(&experiment)?;
    experiment.envs.embodiment.spec().parts().map_err(RunError::from)?;
    #[cfg(feature = "tui")]
    let tui = options.tui && ranks.is_first();
    #[cfg(feature = "tui")]
    if tui && !std::io::IsTerminal::is_terminal(&std::io::stdout()) {
        return Err(CoversError::NoTerminal);
    }
    let folder_options = &options.run_options.run_folder;
    let folder = if ranks.is_first() {
        folder_options.create_run_folder(&options.run_name(&experiment))?
    } else {
        RunFolder::from_path(&folder_options.runs)
    };
    let mut run = Run::start(experiment, folder.with_process_ranks(ranks))?;
    #[cfg(feature = "tui")]
    if tui {
        watch::screen::train_with_screen(&mut run)?;
        run.set_stop_signal(StopSignal::from_os_signals()?);
        return summarise_or_checkpoint(&mut run, options.run_options.run_folder.json, out);
    }
    finish(&mut run, options.run_options.run_folder.json, out)
}

/// Runs to the end or until a signal, and prints every event above a progress bar. A closed output
/// stops the run as a signal does. Ranks but the first print nothing.
fn finish(run: &mut Run, json: bool, out: &mut impl Write) -> Result<CommandOutcome, CoversError> {
    let is_first = run.folder().process_ranks().is_first();
    let mut first_out: &mut dyn Write = if is_first { out } else { &mut sink() };
    let stop = StopSignal::from_os_signals()?;
    run.set_stop_signal(stop.clone());
    let folder = run.folder().path().display();
    let start = format!("{folder}: {}", run.start_message_with_memory());
    say_or_stop(&mut first_out, &start, &Style::new(), &stop);
    say_or_stop(&mut first_out, ROLLOUT_LINE_HEADER, &Style::new().bold(), &stop);
    let bar = progress_bar(run.experiment().schedule.total_decisions());
    bar.set_position(run.stats().decisions as u64);
    bar.reset_eta();
    while let Some(event) = run.advance()? {
        if is_first {
            bar.suspend(|| print_event(&event, run.is_finished(), &mut first_out, &stop));
            bar.set_position(run.stats().decisions as u64);
        }
    }
    bar.finish_and_clear();
    summarise_or_checkpoint(run, json, &mut first_out)
}

/// Prints an event, and its warning to standard error; not the last scores, which are part of the
/// summary.
fn print_event(event: &RunEvent, is_last: bool, out: &mut impl Write, stop: &StopSignal) {
    let mut line = format_run_event(event);
    // the run's log.txt holds them, too
    event.warnings().iter().for_each(|warning| warn(&format!("warning: {warning}")));
    if let RunEvent::Rollout(_) = event {
        let terminal = Term::stdout();
        if terminal.is_term() {
            let columns = usize::from(terminal.size().1);
            line = truncate_str(&line, columns, "…").into_owned();
        }
    }
    if !is_last {
        say_or_stop(out, &line, &event_style(event), stop);
    }
}

/// Returns the style of an event's lines on a terminal: cyan where a policy was created, green
/// where at least 0.9 of the episodes succeeded.
fn event_style(event: &RunEvent) -> Style {
    match event {
        RunEvent::Rollout(rollout) if rollout.iteration.policy_created => Style::new().cyan(),
        RunEvent::Rollout(rollout) if rollout.success_rate() >= Some(0.9) => Style::new().green(),
        _ => Style::new(),
    }
}

/// Prints lines in a style, and requests a stop if standard output is closed.
fn say_or_stop(out: &mut impl Write, line: &str, style: &Style, stop: &StopSignal) {
    if let Err(error) = print_styled(out, line, |text| style.apply_to(text).to_string()) {
        warn(&format!("{error}: the run stops"));
        stop.request();
    }
}

/// Prints the summary of a finished run; of a stopped one, writes a checkpoint and prints the
/// command that continues from it.
///
/// # Errors
/// Errors of the run, or an `out` that the summary cannot be written to.
pub fn summarise_or_checkpoint(
    run: &mut Run,
    json: bool,
    out: &mut impl Write,
) -> Result<CommandOutcome, CoversError> {
    let folder = run.folder().path().display().to_string();
    if run.is_finished()
        && let Some(summary) = run.summary()?
    {
        print_escaped(out, &run_summary_table(&summary))?;
        print_escaped(out, &format!("files: {folder}"))?;
        let (program, word) = (program_name(), shell_word(&folder));
        print_escaped(
            out,
            &format!(
                "next:  {program} report {word} --out report --films\n       \
                 {program} render {word} --out policies.gif"
            ),
        )?;
        if json {
            print_escaped(out, &serde_json::json!(summary).to_string())?;
        }
        return Ok(CommandOutcome::Done);
    }
    run.save_checkpoint()?;
    let rollouts = run.stats().rollouts;
    let (program, word, device) = (program_name(), shell_word(&folder), run.device_option());
    let ending = format!(
        "stopped after {rollouts} rollouts; continue with: {program} resume {word}{device}"
    );
    if print_escaped(out, &ending).is_err() {
        warn(&ending);
    }
    Ok(CommandOutcome::Interrupted)
}

fn evaluate(options: &EvalOptions, out: &mut impl Write) -> Result<(), RunError> {
    let folder = RunFolder::from_path(&options.run_folder);
    let mut experiment =
        folder.read_experiment()?.with_threads(options.threads_and_json.threads.count());
    memory::check_environment_memory(experiment.envs.threads)?;
    match options.embodiment {
        Some(other) => experiment.envs.embodiment = other,
        None => folder.verify_robot(&experiment)?,
    }
    if options.randomised {
        experiment.envs = with_randomisation(experiment.envs);
    } else {
        experiment.envs = experiment.envs.for_evaluation();
    }
    experiment = with_env_overrides(&options.set.overrides, experiment)?;
    let spec = SwitchableVecEnv::env_spec(&experiment.envs);
    let labels = TaskLabel::default();
    let learner = &experiment.learner;
    let (mut learner, own) = folder.load_learner_with_own_policies(learner, &spec, &labels)?;
    // drawn from the option's seed, so that placements of two seeds have nothing in common
    experiment.evaluation.seed = options.seed.unwrap_or(experiment.evaluation.seed);
    let seed = experiment.evaluation_seed();
    let (envs, tasks) = (experiment.envs, TaskRegistry::with_all());
    let mut evaluator = Evaluator::new(envs, &tasks, experiment.schedule, seed, labels)?
        .with_distinct_placements(experiment.evaluation.distinct_placements);
    // a round of one group is an episode of each environment in each of four variants
    let rounds = options.episodes.div_ceil(4 * envs.num_envs);
    let pool = thread_pool(envs.threads)?;
    let (variants, mut results) = (evaluator.task_variants(), EvaluationResults::default());
    let bar = progress_bar(variants.len());
    for variant in variants {
        pool.install(|| {
            evaluator.score_variant(&mut *learner, variant, &own, rounds, &mut results)
        })?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    for cause in &evaluator.take_failure_causes() {
        warn(&format!("warning: {}", environment_failure_warning(cause)));
    }
    let scores = results.scores;
    if options.threads_and_json.json {
        print_escaped(out, &serde_json::json!(scores).to_string())
    } else {
        print_escaped(out, &score_table(&scores))
    }
}

/// Returns `experiment` with overridden settings of the environments.
///
/// # Errors
/// Errors of [`apply_overrides`] and [`Experiment::check_environments`], and
/// [`RunError::InvalidSetting`] if any other setting is overridden.
fn with_env_overrides(
    overrides: &[SettingOverride],
    experiment: Experiment,
) -> Result<Experiment, RunError> {
    if overrides.is_empty() {
        return Ok(experiment);
    }
    let changed = apply_overrides(overrides, experiment.clone())?;
    let envs = VecEnvSettings { threads: experiment.envs.threads, ..changed.envs };
    let accepted = Experiment { envs, ..experiment };
    if let Some(refused) = differing_settings(&changed, &accepted)?.first() {
        return Err(RunError::invalid(
            "--set",
            short_path(&refused.path),
            "a path below `envs`; there are `--episodes`, `--seed` and `--threads`, and \
                       policies are evaluated as they are",
        ));
    }
    accepted.check_environments()?;
    Ok(accepted)
}

/// Returns the parser of the number of episodes of an evaluation.
fn episode_count() -> RangedU64ValueParser<usize> {
    RangedU64ValueParser::new().range(1..=10_000_000)
}

/// Returns settings with randomised images, by the amounts that they have or by nominal ones.
fn with_randomisation(envs: VecEnvSettings) -> VecEnvSettings {
    let amounts = envs.randomisation.unwrap_or_default();
    VecEnvSettings { randomisation: Some(amounts), ..envs }
}

fn pack(options: &PackOptions, out: &mut impl Write) -> Result<(), RunError> {
    if options.out.exists() {
        return Err(RunError::FileExists { path: options.out.clone() });
    }
    let from = RunFolder::from_path(&options.run_folder);
    let experiment = from.read_experiment()?;
    let spec = SwitchableVecEnv::env_spec(&experiment.envs);
    let labels = TaskLabel::default();
    let learner = &experiment.learner;
    let learner = from.load_learner(learner, &spec, &labels)?;
    let episodes = options.episodes;
    let extent = CheckpointExtent::Policies { episodes_per_policy: episodes };
    let parent = parent_folder(&options.out);
    create_dir_all(parent).map_err(RunError::write_error_mapper(parent))?;
    let to = RunFolder::create_with_learner(&options.out, &experiment, &*learner, extent)?;
    print_escaped(out, &format!("{} policies in {}", learner.policy_count(), to.path().display()))
}
