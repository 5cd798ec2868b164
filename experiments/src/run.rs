//! One run over a stream, from the first rollout to the final scores. It can be stopped at any
//! rollout and resumed later.

use std::mem::{Discriminant, discriminant};
use std::path::Path;
use std::time::Instant;

use envs::TaskRegistry;
use rayon::ThreadPool;
use rl::RewardWarning;

use crate::error::RunError;
use crate::evaluation::{Evaluator, VariantScore, average_scores_by_group};
use crate::experiment::Experiment;
use crate::latest_frame::LatestFrame;
use crate::scheduled_vec_env::ScheduledVecEnv;
use learner::{CheckpointExtent, DeviceChoice, IterationReport, Learner};

use super::checkpoints;
use crate::folder::{RunFolder, SAVED_TIMINGS_FILE};
use crate::lock::FolderLock;
use crate::logs::RunTables;
use crate::memory;
use crate::note::RunState;
use crate::printable::printable_message;
use crate::progress::{EvaluationReport, RolloutReport, RunEvent, RunSummary};
use crate::provenance::{Provenance, robot_checksum};
use crate::run_stats::RunStats;
use crate::scoring::{StoppableEvaluation, recognition_repeats};
use crate::start_resume::{self, LockedRun, PreparedRun};
use crate::stop::StopSignal;
use crate::workers::{run_catching_panics, thread_pool};

const LOG: &str = "log.txt";

/// Run in progress, which holds the lock of its folder.
pub struct Run {
    experiment: Experiment,
    folder: RunFolder,
    _lock: Option<FolderLock>,
    tables: RunTables,
    pool: ThreadPool,
    tasks: TaskRegistry,
    stream: ScheduledVecEnv,
    evaluator: Evaluator,
    learner: Box<dyn Learner>,
    stats: RunStats,
    /// Episodes in each environment of the evaluation that is due before the next rollout; 0 for
    /// none.
    due: usize,
    last_scores: Vec<VariantScore>,
    /// Number of rollouts and value of `due` in the newest checkpoint.
    saved: Option<(usize, usize)>,
    /// Kinds of reward warnings that were given, each once.
    warned: Vec<Discriminant<RewardWarning>>,
    /// `true` after an error in the run, which may have left the learner in an inconsistent state.
    broken: bool,
    stop: StopSignal,
    start_message: String,
}

impl Run {
    /// Prepares a new run over task groups of the crate `envs` in `folder`; [`Run::advance`] then
    /// trains it step by step.
    ///
    /// # Errors
    /// [`RunError::InvalidSetting`], [`RunError::FolderHoldsRun`], [`RunError::Locked`]; errors of
    /// the environments or the file system.
    pub fn start(experiment: Experiment, folder: RunFolder) -> Result<Self, RunError> {
        Self::start_with_tasks(experiment, TaskRegistry::with_all(), folder)
    }

    /// Prepares a new run over task groups of the registry `tasks` in `folder`, as [`Run::start`]
    /// does.
    ///
    /// # Errors
    /// As [`Run::start`], and a group that `tasks` does not hold.
    pub fn start_with_tasks(
        experiment: Experiment,
        tasks: TaskRegistry,
        folder: RunFolder,
    ) -> Result<Self, RunError> {
        Self::assemble(start_resume::start(experiment, tasks, folder)?)
    }

    /// Loads the run in `folder` from its newest intact checkpoint, or prepares it from the
    /// beginning if it has none yet, for [`Run::advance`] to continue; [`Run::start_message`] says
    /// which. All files but the timings end as in a run that was never interrupted, byte for byte.
    ///
    /// # Errors
    /// [`RunError::NoRun`], [`RunError::NoCheckpoint`], [`learner::LearnerError::NewerFormat`],
    /// [`learner::LearnerError::CheckpointSettingsDiffer`], [`RunError::Locked`];
    /// [`learner::LearnerError::PoliciesOnlyCheckpoint`] for a packed folder; errors of the
    /// environments.
    pub fn resume(folder: &Path, threads: Option<usize>) -> Result<Self, RunError> {
        let (folder, tasks) = (RunFolder::from_path(folder), TaskRegistry::with_all());
        Self::resume_with_tasks(folder, threads, DeviceChoice::Cpu, tasks)
    }

    /// Loads a run over task groups of `tasks`, as [`Run::resume`] does, and updates its policies
    /// on `device` from here on.
    ///
    /// # Errors
    /// As [`Run::resume`], a group that `tasks` does not hold, and errors of
    /// [`Experiment::with_device`].
    pub fn resume_with_tasks(
        folder: RunFolder,
        threads: Option<usize>,
        device: DeviceChoice,
        tasks: TaskRegistry,
    ) -> Result<Self, RunError> {
        Self::assemble(start_resume::resume(folder, threads, device, tasks)?)
    }

    fn assemble(prepared: PreparedRun) -> Result<Self, RunError> {
        let PreparedRun { locked, labels, state, .. } = prepared;
        let LockedRun { experiment, tasks, folder, lock } = locked;
        let RunState { mut stats, due_episodes_per_env: due, tables } = state;
        // environments before threads: the first model of a process sets an environment variable
        // for software rendering
        let stream = ScheduledVecEnv::new(&experiment, &tasks, labels.clone(), stats.decisions)?;
        let evaluator = Evaluator::for_experiment(&experiment, &tasks, labels)?;
        let pool = thread_pool(experiment.envs.threads)?;
        // tables are opened last, since that removes rows behind the checkpoint, which must not
        // happen if anything else fails
        folder.prepare_for_run()?;
        checkpoints::rename_damaged(folder.disk(), &prepared.unreadable_checkpoints)?;
        let tables = RunTables::open(&folder, stats.rollouts, tables)?;
        stats.seconds = tables.timing_sums().seconds;
        check_equal_on_ranks(&folder, "start after", stats.rollouts as u64)?;
        let run = Self {
            saved: (stats.rollouts > 0).then_some((stats.rollouts, due)),
            experiment,
            pool,
            tasks,
            stream,
            evaluator,
            tables,
            folder,
            _lock: lock,
            learner: prepared.learner,
            stats,
            due,
            last_scores: Vec::new(),
            warned: Vec::new(),
            broken: false,
            stop: StopSignal::default(),
            start_message: prepared.start_message,
        };
        if !run.is_finished() {
            run.folder.mark_unfinished()?;
            run.record_provenance()?;
        }
        Ok(run)
    }

    /// Records this process in the folder's provenance and log.
    fn record_provenance(&self) -> Result<(), RunError> {
        let renderer = envs::mujoco::opengl_description().unwrap_or("none").to_owned();
        let (rollouts, threads) = (self.stats.rollouts, self.experiment.envs.threads);
        let gpu = self.experiment.learner.gpu_name();
        let robot = robot_checksum(self.experiment.envs.embodiment)?;
        let provenance = Provenance::of_this_process(rollouts, threads, renderer, gpu, robot);
        self.folder.record_provenance(&provenance)?;
        self.log(&self.start_message)
    }

    fn log(&self, line: &str) -> Result<(), RunError> {
        self.folder.append_line(LOG, line)
    }

    /// Sets the signal that stops the run between rollouts and between evaluated variants.
    pub fn set_stop_signal(&mut self, stop: StopSignal) {
        self.stop = stop.on_ranks(self.folder.process_ranks().clone());
    }

    /// Publishes the image of the first training environment to `latest_frame` after every training
    /// step.
    pub fn publish_frames_to(&mut self, latest_frame: LatestFrame) {
        self.stream.publish_frames_to(latest_frame);
    }

    /// Returns the message about the run's start: anew, or from which checkpoint, and which newer
    /// ones were damaged.
    pub fn start_message(&self) -> &str {
        &self.start_message
    }

    /// Returns [`Run::start_message`] with the memory that the run needs.
    pub fn start_message_with_memory(&self) -> String {
        let memory = memory::format_gibibytes(memory::run_memory_bytes(&self.experiment));
        format!("{}; takes up to about {memory} of memory", self.start_message)
    }

    /// Returns the settings of the run.
    pub fn experiment(&self) -> &Experiment {
        &self.experiment
    }

    /// Returns the folder of the run.
    pub fn folder(&self) -> &RunFolder {
        &self.folder
    }

    /// Returns the run's statistics so far: rollouts, decisions, seconds, and assignments to
    /// policies.
    pub fn stats(&self) -> &RunStats {
        &self.stats
    }

    /// Returns `true` if all rollouts and evaluations of the run are done.
    pub fn is_finished(&self) -> bool {
        self.due == 0 && self.visit().is_none()
    }

    /// Returns the index of the visit that the next rollout starts in; `None` after the last visit.
    fn visit(&self) -> Option<usize> {
        self.stream.visit_index(self.stats.rollouts)
    }

    /// Trains on one more rollout or runs the evaluation that is due, and saves a checkpoint if one
    /// is due. Returns `None` if the run has finished, or after a [stop](Run::set_stop_signal) was
    /// requested; then [`Run::save_checkpoint`] keeps the progress since the last checkpoint.
    ///
    /// # Errors
    /// Errors of all parts; [`RunError::Panicked`], and [`RunError::FailedEarlier`] after an error.
    /// Files written so far stay, and the last checkpoint can be resumed.
    pub fn advance(&mut self) -> Result<Option<RunEvent>, RunError> {
        if self.broken {
            return Err(RunError::FailedEarlier);
        }
        let event = self.step().map_err(|error| self.with_room_needed(error));
        if let Err(error) = &event {
            self.broken = true;
            // if the log cannot be written either, the first error is the one to return
            let _ = self.log(&format!("error: {}", printable_message(error)));
        }
        event
    }

    fn step(&mut self) -> Result<Option<RunEvent>, RunError> {
        if self.stop.is_requested() {
            return Ok(None);
        }
        let event = match (self.due, self.visit()) {
            (0, None) => return Ok(None),
            (0, Some(index)) => {
                let progress = self.learn(index)?;
                self.due = self.due_after(index);
                RunEvent::Rollout(Box::new(progress))
            }
            (rounds, _) => match self.score(rounds)? {
                Some(evaluation) => RunEvent::Evaluation(evaluation),
                None => return Ok(None),
            },
        };
        for warning in event.warnings() {
            self.log(&format!("warning: {warning}"))?;
        }
        let (every, rollouts) = (self.experiment.checkpoints.every, self.stats.rollouts);
        // the last checkpoints are saved both before and after the final evaluation, which may take
        // minutes
        if self.visit().is_none() || (rollouts > 0 && rollouts.is_multiple_of(every)) {
            self.save_checkpoint()?;
        }
        Ok(Some(event))
    }

    /// Returns the episodes in each environment of the evaluation that is due after a rollout that
    /// started in the visit with this index; 0 for none.
    fn due_after(&self, index: usize) -> usize {
        let plan = &self.experiment.evaluation;
        match self.visit() {
            None => plan.episodes_per_env,
            Some(next) if next > index => plan.visit_episodes_per_env,
            Some(_) => plan.episodes_per_env_within_visit(self.stats.rollouts),
        }
    }

    /// Runs one iteration of the learner, which starts in the visit with this index.
    fn learn(&mut self, index: usize) -> Result<RolloutReport, RunError> {
        let clock = Instant::now();
        let rollout = self.stats.rollouts;
        let (visit, before) = self.stream.visit_and_earlier(index);
        let group = self.tasks.find(&visit.group)?;
        // a visit that follows one of its own group does not return to it
        let mut since_first = before.iter().skip_while(|earlier| earlier.group != visit.group);
        let returns = since_first.any(|earlier| earlier.group != visit.group);
        let (learner, stream) = (&mut self.learner, &mut self.stream);
        stream.begin_iteration(rollout, index)?;
        let failures_before = stream.environments().environment_failures();
        let seconds_before = stream.environments().environment_seconds();
        let iteration: IterationReport =
            run_catching_panics(&self.pool, || Ok(learner.learn(stream)?))?;
        let seconds = clock.elapsed().as_secs_f64();
        let stats = &mut self.stats;
        if stream.spans_switch() {
            stats.record_task_switch(iteration.policy);
        } else {
            stats.record_rollout(group.name(), returns, iteration.policy);
        }
        stats.record_merges(&iteration.merged_into);
        stats.decisions = stream.decisions_so_far();
        stats.environment_failures +=
            stream.environments().environment_failures() - failures_before;
        stats.seconds += seconds;
        let warning = iteration
            .rollout_stats
            .reward_warning()
            .filter(|warning| !self.warned.contains(&discriminant(warning)));
        let progress = RolloutReport {
            rollout,
            decisions: stats.decisions,
            group,
            last_group: self
                .tasks
                .find(&stream.visit_and_earlier(stream.last_shown_visit_index()).0.group)?,
            spans_switch: stream.spans_switch(),
            iteration,
            warning,
            environment_failures: stream.take_failure_causes(),
            reward_scale: stream.environments().reward_scale(),
            seconds,
            environment_seconds: stream.environments().environment_seconds() - seconds_before,
        };
        self.tables.write_rollout(&progress)?;
        self.warned.extend(warning.as_ref().map(discriminant));
        Ok(progress)
    }

    /// Runs the evaluation that is due; `None` if a stop was requested.
    fn score(&mut self, rounds: usize) -> Result<Option<EvaluationReport>, RunError> {
        let stop = self.stop.clone();
        // recognition is tested after the stream only
        let repeats = self.visit().map_or_else(|| recognition_repeats(&self.experiment), |_| 0);
        let Some(results) = self.scoring(&stop).score(rounds, repeats)? else {
            return Ok(None);
        };
        let evaluation = EvaluationReport {
            rollouts: self.stats.rollouts,
            decisions: self.stats.decisions,
            results,
        };
        self.tables.write_evaluation(&evaluation)?;
        self.last_scores.clone_from(&evaluation.results.scores);
        self.due = 0;
        Ok(Some(evaluation))
    }

    /// Scores the learner now on all variants of all groups, with `rounds` episodes in each
    /// environment; the run's tables do not record the scores.
    ///
    /// # Errors
    /// Errors of the evaluation.
    pub fn evaluate(&mut self, rounds: usize) -> Result<Vec<VariantScore>, RunError> {
        let results = self.scoring(&StopSignal::default()).score(rounds, 0)?;
        Ok(results.unwrap_or_default().scores)
    }

    fn scoring<'a>(&'a mut self, stop: &'a StopSignal) -> StoppableEvaluation<'a> {
        let (learner, evaluator) = (&mut *self.learner, &mut self.evaluator);
        StoppableEvaluation::new(&self.pool, learner, evaluator, self.stats.own_policies(), stop)
    }

    /// Writes a checkpoint of the run, unless the newest one is up to date.
    ///
    /// # Errors
    /// [`RunError::FailedEarlier`], [`learner::LearnerError::NotFinite`], [`RunError::Write`].
    /// Older checkpoints stay.
    pub fn save_checkpoint(&mut self) -> Result<(), RunError> {
        if self.broken {
            return Err(RunError::FailedEarlier);
        }
        let (rollouts, due) = (self.stats.rollouts, self.due);
        if self.saved == Some((rollouts, due)) {
            return Ok(());
        }
        let path = checkpoints::checkpoint_path(&self.folder.checkpoint_folder(), rollouts);
        let state = RunState {
            stats: self.stats.clone(),
            due_episodes_per_env: due,
            tables: self.tables.snapshot(),
        };
        let note = state
            .into_checkpoint_json(&self.experiment)
            .map_err(RunError::write_error_mapper(&path))?;
        let bytes = self.learner.to_checkpoint_bytes(&path, CheckpointExtent::Everything, &note)?;
        let checksum = crc32fast::hash(&bytes).into();
        check_equal_on_ranks(&self.folder, "have checkpoints with checksums", checksum)?;
        if self.folder.process_ranks().is_first() {
            let needed = Some(bytes.len() as u64);
            self.write_checkpoint(&bytes).map_err(|error| {
                error.on_full_disk(self.folder.path(), self.device_option(), needed)
            })?;
        }
        self.saved = Some((rollouts, due));
        Ok(())
    }

    fn write_checkpoint(&self, bytes: &[u8]) -> Result<(), RunError> {
        // tables and logs are synced first, so that a checkpoint is never ahead of them on the disk
        self.tables.sync()?;
        self.folder.replace_file(SAVED_TIMINGS_FILE, self.tables.timings_csv())?;
        self.folder.sync_files(&[Provenance::FILE_NAME, LOG])?;
        let (disk, keep) = (self.folder.disk(), self.experiment.checkpoints.keep);
        let (folder, rollouts) = (self.folder.checkpoint_folder(), self.stats.rollouts);
        checkpoints::write_checkpoint(disk, &folder, rollouts, bytes, keep)
    }

    /// Returns the summary of the run with the scores of the last evaluation, and writes that of a
    /// finished run to `summary.json`. If no evaluation was due since the start or the resumption,
    /// all variants are scored first; `None` if a [stop](Run::set_stop_signal) is requested before
    /// that is done.
    ///
    /// # Errors
    /// Errors of the evaluation or of writing the file.
    pub fn summary(&mut self) -> Result<Option<RunSummary>, RunError> {
        if self.last_scores.is_empty() {
            let rounds = self.experiment.evaluation.episodes_per_env;
            let stop = self.stop.clone();
            let Some(results) = self.scoring(&stop).score(rounds, 0)? else {
                return Ok(None);
            };
            self.last_scores = results.scores;
        }
        let stats = &self.stats;
        let summary = RunSummary {
            decisions: stats.decisions,
            seconds: stats.seconds,
            decisions_per_second: self.tables.timing_sums().decisions_per_second(),
            policies: self.learner.policy_count(),
            merged_policies: stats.merged_policy_count(),
            environment_failures: stats.environment_failures,
            switch_rollouts: stats.switch_rollouts,
            assignment_accuracy: stats.assignment_accuracy(),
            revisit_accuracy: stats.revisit_accuracy(),
            groups: average_scores_by_group(&self.last_scores),
            variants: self.last_scores.clone(),
            table_checksums: self.tables.checksums(),
        };
        if self.is_finished() {
            summary.write(&self.folder).map_err(|error| self.with_room_needed(error))?;
        }
        Ok(Some(summary))
    }

    /// Returns the option of `covers resume` for the run's device, which no file names; empty for the
    /// CPU.
    pub fn device_option(&self) -> &'static str {
        self.experiment.learner.gpu_name().map_or("", |_| " --device gpu")
    }

    /// Adds to an error of a full disk how to continue, and the size of the newest checkpoint.
    fn with_room_needed(&self, error: RunError) -> RunError {
        let checkpoints =
            checkpoints::list_checkpoints(&self.folder.checkpoint_folder()).unwrap_or_default();
        let newest = checkpoints.first().and_then(|(_, path)| path.metadata().ok());
        let size = newest.map(|file| file.len());
        error.on_full_disk(self.folder.path(), self.device_option(), size)
    }
}

/// Checks that `own` is the same number on all ranks.
fn check_equal_on_ranks(folder: &RunFolder, what: &'static str, own: u64) -> Result<(), RunError> {
    let values = folder.process_ranks().all_gather_numbers(own);
    if values.iter().all(|&value| value == own) {
        return Ok(());
    }
    Err(RunError::RanksDiffer { what, values })
}
