//! One run over a stream, from the first rollout to the final scores. It can be stopped at any
//! rollout and resumed later.

use std::mem::{Discriminant, discriminant};
use std::path::Path;
use std::time::Instant;

use envs::TaskRegistry;
use rayon::ThreadPool;
use rl::RewardWarning;

use crate::clocked_stream::ClockedStream;
use crate::error::RunError;
use crate::evaluation::{Evaluator, Score, by_group};
use crate::experiment::Experiment;
use crate::latest_frame::LatestFrame;
use learner::{DeviceChoice, Extent, Iteration, Learner};

use super::checkpoints;
use crate::folder::RunFolder;
use crate::lock::Lock;
use crate::logs::Logs;
use crate::note::RunState;
use crate::progress::{Evaluation, Event, Progress, Summary};
use crate::provenance::Provenance;
use crate::run_stats::RunStats;
use crate::scoring::{Scoring, looks};
use crate::start_resume::{self, LockedRun, PreparedRun};
use crate::stop::StopSignal;
use crate::workers::{guarded, thread_pool};

const LOG: &str = "log.txt";

/// Run in progress, which holds the lock of its folder.
pub struct Run {
    experiment: Experiment,
    folder: RunFolder,
    _lock: Lock,
    logs: Logs,
    pool: ThreadPool,
    tasks: TaskRegistry,
    stream: ClockedStream,
    evaluator: Evaluator,
    learner: Box<dyn Learner>,
    stats: RunStats,
    /// Rounds of the evaluation that is due before the next rollout; 0 for none.
    due: usize,
    last_scores: Vec<Score>,
    /// Rollouts and rounds due in the newest checkpoint.
    saved: Option<(usize, usize)>,
    /// Kinds of reward warnings that were given, each once.
    warned: Vec<Discriminant<RewardWarning>>,
    /// `true` after an error, which may have left the learner in an inconsistent state.
    broken: bool,
    stop: StopSignal,
    notice: String,
}

impl Run {
    /// Starts a run over the paper's four task groups that writes its files to `folder`.
    ///
    /// # Errors
    /// [`RunError::Setting`], [`RunError::Occupied`], [`RunError::Locked`]; errors of the
    /// environments or the file system.
    pub fn start(experiment: Experiment, folder: RunFolder) -> Result<Self, RunError> {
        Self::start_with(experiment, TaskRegistry::standard(), folder)
    }

    /// Starts a run over task groups of `tasks` that writes its files to `folder`.
    ///
    /// # Errors
    /// As [`Run::start`], and a group that `tasks` does not hold.
    pub fn start_with(
        experiment: Experiment,
        tasks: TaskRegistry,
        folder: RunFolder,
    ) -> Result<Self, RunError> {
        Self::assemble(start_resume::start(experiment, tasks, folder)?)
    }

    /// Resumes the run in `folder` from its newest intact checkpoint, or starts it again if it has
    /// no checkpoint yet; [`Run::notice`] says which. All files but the timings end as in a run
    /// that was never interrupted, byte for byte.
    ///
    /// # Errors
    /// [`RunError::NoRun`], [`RunError::NoCheckpoint`], [`learner::LearnerError::NewerFormat`],
    /// [`learner::LearnerError::OtherSettings`], [`RunError::Locked`];
    /// [`learner::LearnerError::PoliciesOnly`] for a packed folder; errors of the environments.
    pub fn resume(folder: &Path, threads: Option<usize>) -> Result<Self, RunError> {
        let (folder, tasks) = (RunFolder::open(folder), TaskRegistry::standard());
        Self::resume_with(folder, threads, DeviceChoice::Cpu, tasks)
    }

    /// Resumes a run over task groups of `tasks`, with policies that are updated on `device`; see
    /// [`Run::resume`].
    ///
    /// # Errors
    /// As [`Run::resume`], a group that `tasks` does not hold, and errors of
    /// [`Experiment::with_device`].
    pub fn resume_with(
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
        let RunState { mut stats, due, tables } = state;
        // environments before threads: the first model of a process sets an environment variable
        // for software rendering
        let stream = ClockedStream::new(&experiment, &tasks, labels.clone(), stats.decisions)?;
        let evaluator = Evaluator::of(&experiment, &tasks, labels)?;
        let pool = thread_pool(experiment.envs.threads)?;
        // tables are opened last, since that removes rows behind the checkpoint, which must not
        // happen if anything else fails
        folder.prepare()?;
        checkpoints::put_aside(folder.disk(), &prepared.passed_over)?;
        if folder.is_finished() {
            folder.drop_changed_timings()?;
        }
        let logs = Logs::open(&folder, stats.rollouts, tables)?;
        stats.seconds = logs.timings().seconds;
        let run = Self {
            saved: (stats.rollouts > 0).then_some((stats.rollouts, due)),
            experiment,
            pool,
            tasks,
            stream,
            evaluator,
            logs,
            folder,
            _lock: lock,
            learner: prepared.learner,
            stats,
            due,
            last_scores: Vec::new(),
            warned: Vec::new(),
            broken: false,
            stop: StopSignal::default(),
            notice: prepared.notice,
        };
        if !run.is_finished() {
            run.folder.reopen()?;
            run.record_provenance()?;
        }
        Ok(run)
    }

    /// Records this process in the folder's provenance and log.
    fn record_provenance(&self) -> Result<(), RunError> {
        let renderer = envs::mujoco::opengl().unwrap_or("none").to_owned();
        let (rollouts, threads) = (self.stats.rollouts, self.experiment.envs.threads);
        let gpu = self.experiment.learner.gpu();
        let provenance = Provenance::here(rollouts, threads, renderer, gpu);
        self.folder.record_provenance(&provenance)?;
        self.log(&self.notice)
    }

    fn log(&self, line: &str) -> Result<(), RunError> {
        self.folder.append(LOG, line)
    }

    /// Sets the signal that stops the run between rollouts and between evaluated variants.
    pub fn stop_at(&mut self, stop: StopSignal) {
        self.stop = stop;
    }

    /// Publishes the image of the first training environment to `latest_frame` after every training
    /// step.
    pub fn publish_frames_to(&mut self, latest_frame: LatestFrame) {
        self.stream.publish_frames_to(latest_frame);
    }

    /// Returns the message about the run's start: anew, or from which checkpoint, and which newer
    /// ones were damaged.
    pub fn notice(&self) -> &str {
        &self.notice
    }

    /// Returns the settings of the run.
    pub fn experiment(&self) -> &Experiment {
        &self.experiment
    }

    /// Returns the folder of the run.
    pub fn folder(&self) -> &RunFolder {
        &self.folder
    }

    /// Returns the statistics of the run so far.
    pub fn stats(&self) -> &RunStats {
        &self.stats
    }

    /// Returns `true` if all rollouts and evaluations of the run are done.
    pub fn is_finished(&self) -> bool {
        self.due == 0 && self.visit().is_none()
    }

    /// Returns the index of the visit that the next rollout starts in; `None` after the last.
    fn visit(&self) -> Option<usize> {
        self.stream.index(self.stats.rollouts)
    }

    /// Trains on one more rollout or runs the evaluation that is due, and saves a checkpoint if one
    /// is due. Returns `None` if the run has finished, or after a [stop](Run::stop_at) was
    /// requested; then [`Run::save`] keeps the progress since the last checkpoint.
    ///
    /// # Errors
    /// Errors of all parts; [`RunError::Panicked`], and [`RunError::Broken`] after an error. Files
    /// written so far stay, and the last checkpoint can be resumed.
    pub fn advance(&mut self) -> Result<Option<Event>, RunError> {
        if self.broken {
            return Err(RunError::Broken);
        }
        let event = self.step();
        if let Err(error) = &event {
            self.broken = true;
            // if the log cannot be written either, the first error is the one to return
            let _ = self.log(&format!("error: {error}"));
        }
        event
    }

    fn step(&mut self) -> Result<Option<Event>, RunError> {
        if self.stop.requested() {
            return Ok(None);
        }
        let event = match (self.due, self.visit()) {
            (0, None) => return Ok(None),
            (0, Some(index)) => {
                let progress = self.learn(index)?;
                self.due = self.evaluation_rounds(index);
                Event::Rollout(Box::new(progress))
            }
            (rounds, _) => match self.score(rounds)? {
                Some(evaluation) => Event::Evaluation(evaluation),
                None => return Ok(None),
            },
        };
        let (every, rollouts) = (self.experiment.checkpoints.every, self.stats.rollouts);
        // the last checkpoints are saved both before and after the final evaluation, which may take
        // minutes
        if self.visit().is_none() || (rollouts > 0 && rollouts.is_multiple_of(every)) {
            self.save()?;
        }
        Ok(Some(event))
    }

    /// Returns the rounds of the evaluation that is due after a rollout that started in the visit
    /// with this index; 0 for none.
    fn evaluation_rounds(&self, index: usize) -> usize {
        let plan = &self.experiment.evaluation;
        match self.visit() {
            None => plan.rounds,
            Some(next) if next > index => plan.visit_rounds,
            Some(_) => plan.within_visit(self.stats.rollouts),
        }
    }

    /// Runs one iteration of the learner, which starts in the visit with this index.
    fn learn(&mut self, index: usize) -> Result<Progress, RunError> {
        let clock = Instant::now();
        let rollout = self.stats.rollouts;
        let (visit, before) = self.stream.visit(index);
        let group = self.tasks.get(&visit.group)?;
        let returns = before.iter().any(|earlier| earlier.group == visit.group);
        let (learner, stream) = (&mut self.learner, &mut self.stream);
        stream.begin(rollout, index)?;
        let failures_before = stream.environments().failures();
        let seconds_before = stream.environments().seconds();
        let iteration: Iteration = guarded(&self.pool, || Ok(learner.learn(stream)?))?;
        let seconds = clock.elapsed().as_secs_f64();
        let stats = &mut self.stats;
        if stream.spans_switch() {
            stats.record_task_switch(iteration.policy);
        } else {
            stats.record(group.name(), returns, iteration.policy);
        }
        stats.record_merges(&iteration.merged_into);
        stats.decisions = stream.now();
        stats.failures += stream.environments().failures() - failures_before;
        stats.seconds += seconds;
        let warning = iteration
            .rollout
            .reward_warning()
            .filter(|warning| !self.warned.contains(&discriminant(warning)));
        let progress = Progress {
            rollout,
            decisions: stats.decisions,
            group,
            last_group: self.tasks.get(&stream.visit(stream.last_shown()).0.group)?,
            spans_switch: stream.spans_switch(),
            iteration,
            warning,
            reward_scale: stream.environments().reward_scale(),
            seconds,
            environment_seconds: stream.environments().seconds() - seconds_before,
        };
        self.logs.write_rollout(&progress)?;
        if let Some(warning) = warning {
            self.warned.push(discriminant(&warning));
            self.log(&format!("warning: {warning}"))?;
        }
        Ok(progress)
    }

    /// Runs the evaluation that is due; `None` if a stop was requested.
    fn score(&mut self, rounds: usize) -> Result<Option<Evaluation>, RunError> {
        let stop = self.stop.clone();
        // recognition is tested after the stream only
        let looks = self.visit().map_or_else(|| looks(&self.experiment), |_| 0);
        let Some(findings) = self.scoring(&stop).score(rounds, looks)? else {
            return Ok(None);
        };
        let evaluation =
            Evaluation { rollouts: self.stats.rollouts, decisions: self.stats.decisions, findings };
        self.logs.write_scores(&evaluation)?;
        self.last_scores.clone_from(&evaluation.findings.scores);
        self.due = 0;
        Ok(Some(evaluation))
    }

    /// Scores the learner now on all variants of all groups, with `rounds` episodes in each
    /// environment.
    ///
    /// # Errors
    /// Errors of the evaluation.
    pub fn evaluate(&mut self, rounds: usize) -> Result<Vec<Score>, RunError> {
        let findings = self.scoring(&StopSignal::default()).score(rounds, 0)?;
        Ok(findings.unwrap_or_default().scores)
    }

    fn scoring<'a>(&'a mut self, stop: &'a StopSignal) -> Scoring<'a> {
        let (learner, evaluator) = (&mut *self.learner, &mut self.evaluator);
        Scoring::new(&self.pool, learner, evaluator, self.stats.own_policies(), stop)
    }

    /// Writes a checkpoint of the run, unless the newest one is up to date.
    ///
    /// # Errors
    /// [`RunError::Broken`], [`learner::LearnerError::NotFinite`], [`RunError::Write`]. Older
    /// checkpoints stay.
    pub fn save(&mut self) -> Result<(), RunError> {
        if self.broken {
            return Err(RunError::Broken);
        }
        let (rollouts, due) = (self.stats.rollouts, self.due);
        if self.saved == Some((rollouts, due)) {
            return Ok(());
        }
        let path = checkpoints::path(&self.folder.checkpoints(), rollouts);
        let state = RunState { stats: self.stats.clone(), due, tables: self.logs.snapshots() };
        let note = state.into_note(&self.experiment);
        let note = note.map_err(|error| RunError::write(&path, error))?;
        let bytes = self.learner.encode(&path, Extent::Everything, &note)?;
        // tables and logs are synced first, so that a checkpoint is never ahead of them on the disk
        self.logs.sync()?;
        self.folder.sync(&[Provenance::FILE, LOG])?;
        let (disk, keep) = (self.folder.disk(), self.experiment.checkpoints.keep);
        checkpoints::save(disk, &self.folder.checkpoints(), rollouts, &bytes, keep)?;
        self.saved = Some((rollouts, due));
        Ok(())
    }

    /// Returns the summary of the run with the scores of the last evaluation, and writes that of a
    /// finished run to `summary.json`. If no evaluation was due since the start or the resumption,
    /// all variants are scored first; `None` if a [stop](Run::stop_at) is requested before that is
    /// done.
    ///
    /// # Errors
    /// Errors of the evaluation or of writing the file.
    pub fn summary(&mut self) -> Result<Option<Summary>, RunError> {
        if self.last_scores.is_empty() {
            let rounds = self.experiment.evaluation.rounds;
            let stop = self.stop.clone();
            let Some(findings) = self.scoring(&stop).score(rounds, 0)? else {
                return Ok(None);
            };
            self.last_scores = findings.scores;
        }
        let stats = &self.stats;
        let summary = Summary {
            decisions: stats.decisions,
            seconds: stats.seconds,
            decisions_per_second: self.logs.timings().decisions_per_second(),
            policies: self.learner.policies(),
            merged: stats.merged(),
            failures: stats.failures,
            spanning_switch: stats.spanning_switch,
            assignment_accuracy: stats.accuracy(),
            return_accuracy: stats.return_accuracy(),
            groups: by_group(&self.last_scores),
            variants: self.last_scores.clone(),
            tables: self.logs.checksums(),
        };
        if self.is_finished() {
            summary.write(&self.folder)?;
        }
        Ok(Some(summary))
    }
}
