//! One run over a stream, from the first rollout to the final scores; it can stop anywhere and go
//! on later.

use std::mem::{Discriminant, discriminant};
use std::path::Path;
use std::time::Instant;

use envs::TaskRegistry;
use rayon::ThreadPool;
use rl::RewardWarning;

use crate::error::RunError;
use crate::evaluation::{Evaluator, Score, by_group};
use crate::experiment::Experiment;
use crate::glimpse::Glimpse;
use crate::world::World;
use learner::{DeviceChoice, Extent, Iteration, Learner};

use super::checkpoints;
use crate::folder::RunFolder;
use crate::ledger::Ledger;
use crate::lock::Lock;
use crate::logs::Logs;
use crate::note::Note;
use crate::opening::{self, Claim, Opened};
use crate::progress::{Evaluation, Event, Progress, Summary};
use crate::provenance::Provenance;
use crate::scoring::{Scoring, looks};
use crate::stop::Stop;
use crate::workers::{guarded, thread_pool};

const LOG: &str = "log.txt";

/// A run in progress. Nobody else can write to its folder meanwhile.
pub struct Run {
    experiment: Experiment,
    folder: RunFolder,
    _lock: Lock,
    logs: Logs,
    pool: ThreadPool,
    tasks: TaskRegistry,
    world: World,
    evaluator: Evaluator,
    learner: Box<dyn Learner>,
    ledger: Ledger,
    /// Rounds of the evaluation that is due before the next rollout; 0 for none.
    due: usize,
    last_scores: Vec<Score>,
    /// Rollouts and rounds due in the newest checkpoint.
    saved: Option<(usize, usize)>,
    /// Kinds of warnings of the rewards' scale that were given; each is given once.
    warned: Vec<Discriminant<RewardWarning>>,
    /// Whether an error left the learner in between.
    broken: bool,
    stop: Stop,
    notice: String,
}

impl Run {
    /// Begins a run over the paper's task groups that writes its files to `folder`.
    ///
    /// # Errors
    /// A setting out of range; [`RunError::Occupied`] and [`RunError::Locked`]; what the
    /// environments or the file system say.
    pub fn start(experiment: Experiment, folder: RunFolder) -> Result<Self, RunError> {
        Self::start_with(experiment, TaskRegistry::standard(), folder)
    }

    /// Begins a run over groups of `tasks`.
    ///
    /// # Errors
    /// As [`Run::start`], and a group that `tasks` does not hold.
    pub fn start_with(
        experiment: Experiment,
        tasks: TaskRegistry,
        folder: RunFolder,
    ) -> Result<Self, RunError> {
        Self::assemble(opening::start(experiment, tasks, folder)?)
    }

    /// Goes on from the newest intact checkpoint of the run in `folder`, to the same files byte for
    /// byte, timings aside; from the beginning where there is no checkpoint yet.
    /// [`Run::notice`] says which it was.
    ///
    /// # Errors
    /// [`RunError::NoRun`], [`RunError::NoCheckpoint`], [`learner::LearnerError::NewerFormat`],
    /// [`learner::LearnerError::OtherSettings`], [`RunError::Locked`];
    /// [`learner::LearnerError::PoliciesOnly`] where it is a packed one; what the environments say.
    pub fn resume(folder: &Path, threads: Option<usize>) -> Result<Self, RunError> {
        let (folder, tasks) = (RunFolder::open(folder), TaskRegistry::standard());
        Self::resume_with(folder, threads, DeviceChoice::Cpu, tasks)
    }

    /// As [`Run::resume`], for a run over groups of `tasks`, whose policies learn on `device`.
    ///
    /// # Errors
    /// As there, a group that `tasks` does not hold, and those of [`Experiment::with_device`].
    pub fn resume_with(
        folder: RunFolder,
        threads: Option<usize>,
        device: DeviceChoice,
        tasks: TaskRegistry,
    ) -> Result<Self, RunError> {
        Self::assemble(opening::resume(folder, (threads, device), tasks)?)
    }

    fn assemble(opened: Opened) -> Result<Self, RunError> {
        let Opened { claim, labels, note, .. } = opened;
        let Claim { experiment, tasks, folder, lock } = claim;
        let Note { mut ledger, due, rows } = note;
        // environments before threads: the first model of a process tunes software rendering
        let world = World::new(&experiment, &tasks, labels.clone(), ledger.decisions)?;
        let evaluator = Evaluator::of(&experiment, &tasks, labels)?;
        let pool = thread_pool(experiment.envs.threads)?;
        // last: where anything else fails, no rows are cut off
        folder.prepare()?;
        checkpoints::put_aside(folder.disk(), &opened.passed_over)?;
        if folder.is_finished() {
            folder.drop_changed_timings()?;
        }
        let logs = Logs::open(&folder, ledger.rollouts, rows)?;
        ledger.seconds = logs.timings().seconds;
        let run = Self {
            saved: (ledger.rollouts > 0).then_some((ledger.rollouts, due)),
            experiment,
            pool,
            tasks,
            world,
            evaluator,
            logs,
            folder,
            _lock: lock,
            learner: opened.learner,
            ledger,
            due,
            last_scores: Vec::new(),
            warned: Vec::new(),
            broken: false,
            stop: Stop::default(),
            notice: opened.notice,
        };
        if !run.is_finished() {
            run.folder.reopen()?;
            run.sign()?;
        }
        Ok(run)
    }

    /// Notes who works on the run.
    fn sign(&self) -> Result<(), RunError> {
        let renderer = envs::mujoco::opengl().unwrap_or("none").to_owned();
        let (rollouts, threads) = (self.ledger.rollouts, self.experiment.envs.threads);
        let gpu = self.experiment.learner.gpu();
        let provenance = Provenance::here(rollouts, threads, renderer, gpu);
        self.folder.sign(&provenance)?;
        self.log(&self.notice)
    }

    fn log(&self, line: &str) -> Result<(), RunError> {
        self.folder.append(LOG, line)
    }

    /// The run stops at `stop`'s wish.
    pub fn stop_at(&mut self, stop: Stop) {
        self.stop = stop;
    }

    /// The run leaves the newest picture there while it learns.
    pub fn show_to(&mut self, glimpse: Glimpse) {
        self.world.show_to(glimpse);
    }

    /// How the run began: anew, or from which checkpoint, and why not from a newer one.
    pub fn notice(&self) -> &str {
        &self.notice
    }

    /// The settings.
    pub fn experiment(&self) -> &Experiment {
        &self.experiment
    }

    /// Where the files are.
    pub fn folder(&self) -> &RunFolder {
        &self.folder
    }

    /// The books so far.
    pub fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    /// Whether nothing is left to do.
    pub fn is_finished(&self) -> bool {
        self.due == 0 && self.visit().is_none()
    }

    /// The index of the visit that the next rollout begins in.
    fn visit(&self) -> Option<usize> {
        self.world.index(self.ledger.rollouts)
    }

    /// Learns from one more rollout, or evaluates where that is due, and saves where that is due.
    /// None where nothing is left to do, or where a [stop](Run::stop_at) is wished for: then
    /// [`Run::save`] keeps what was learnt.
    ///
    /// # Errors
    /// What any part says; [`RunError::Panicked`], and [`RunError::Broken`] after an error.
    /// Files written so far stay, and the last checkpoint can be resumed.
    pub fn advance(&mut self) -> Result<Option<Event>, RunError> {
        if self.broken {
            return Err(RunError::Broken);
        }
        let event = self.step();
        if let Err(error) = &event {
            self.broken = true;
            // the error itself counts more than that it could not be noted
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
        let (every, rollouts) = (self.experiment.checkpoints.every, self.ledger.rollouts);
        // before an evaluation, which may take minutes, and after it
        if self.visit().is_none() || (rollouts > 0 && rollouts.is_multiple_of(every)) {
            self.save()?;
        }
        Ok(Some(event))
    }

    /// Rounds of the evaluation that is due after a rollout that began in the visit of this index;
    /// 0 for none.
    fn evaluation_rounds(&self, index: usize) -> usize {
        let plan = &self.experiment.evaluation;
        match self.visit() {
            None => plan.rounds,
            Some(next) if next > index => plan.visit_rounds,
            Some(_) => plan.within_visit(self.ledger.rollouts),
        }
    }

    /// One turn of the learner, which begins in the visit of this index.
    fn learn(&mut self, index: usize) -> Result<Progress, RunError> {
        let clock = Instant::now();
        let rollout = self.ledger.rollouts;
        let (visit, before) = self.world.visit(index);
        let group = self.tasks.get(&visit.group)?;
        let returns = before.iter().any(|earlier| earlier.group == visit.group);
        let (learner, world) = (&mut self.learner, &mut self.world);
        world.begin(rollout, index)?;
        let (failures, spent) = (world.stream().failures(), world.stream().seconds());
        let turn: Iteration = guarded(&self.pool, || Ok(learner.learn(world)?))?;
        let seconds = clock.elapsed().as_secs_f64();
        let ledger = &mut self.ledger;
        if world.straddles() {
            ledger.record_straddling(turn.policy);
        } else {
            ledger.record(group.name(), returns, turn.policy);
        }
        ledger.record_heirs(&turn.merged_into);
        ledger.decisions = world.now();
        ledger.failures += world.stream().failures() - failures;
        ledger.seconds += seconds;
        let warning = turn.rollout.reward_warning();
        let warning = warning.filter(|warning| !self.warned.contains(&discriminant(warning)));
        let progress = Progress {
            rollout,
            decisions: ledger.decisions,
            group,
            last_group: self.tasks.get(&world.visit(world.last_shown()).0.group)?,
            straddles: world.straddles(),
            turn,
            warning,
            reward_scale: world.stream().reward_scale(),
            seconds,
            environment_seconds: world.stream().seconds() - spent,
        };
        self.logs.write_rollout(&progress)?;
        if let Some(warning) = warning {
            self.warned.push(discriminant(&warning));
            self.log(&format!("warning: {warning}"))?;
        }
        Ok(progress)
    }

    /// The evaluation that is due; none where a stop was wished for.
    fn score(&mut self, rounds: usize) -> Result<Option<Evaluation>, RunError> {
        let stop = self.stop.clone();
        let looks = self.visit().map_or_else(|| looks(&self.experiment), |_| 0);
        let Some(findings) = self.scoring(&stop).score(rounds, looks)? else {
            return Ok(None);
        };
        let evaluation = Evaluation {
            rollouts: self.ledger.rollouts,
            decisions: self.ledger.decisions,
            findings,
        };
        self.logs.write_scores(&evaluation)?;
        self.last_scores.clone_from(&evaluation.findings.scores);
        self.due = 0;
        Ok(Some(evaluation))
    }

    /// Scores all variants of all groups now, with `rounds` episodes in each environment.
    ///
    /// # Errors
    /// What the evaluation says.
    pub fn evaluate(&mut self, rounds: usize) -> Result<Vec<Score>, RunError> {
        let findings = self.scoring(&Stop::default()).score(rounds, 0)?;
        Ok(findings.unwrap_or_default().scores)
    }

    fn scoring<'a>(&'a mut self, stop: &'a Stop) -> Scoring<'a> {
        let (learner, evaluator) = (&mut *self.learner, &mut self.evaluator);
        Scoring::new(&self.pool, learner, evaluator, self.ledger.own_policies(), stop)
    }

    /// Writes a checkpoint, unless the newest is of this very moment.
    ///
    /// # Errors
    /// [`RunError::Broken`], [`learner::LearnerError::NotFinite`], [`RunError::Write`]; older
    /// checkpoints are then still there.
    pub fn save(&mut self) -> Result<(), RunError> {
        if self.broken {
            return Err(RunError::Broken);
        }
        let (rollouts, due) = (self.ledger.rollouts, self.due);
        if self.saved == Some((rollouts, due)) {
            return Ok(());
        }
        let path = checkpoints::path(&self.folder.checkpoints(), rollouts);
        let note = Note { ledger: self.ledger.clone(), due, rows: self.logs.rows() };
        let note = note.sign(&self.experiment);
        let note = note.map_err(|error| RunError::write(&path, error))?;
        let bytes = self.learner.encode(&path, Extent::Everything, &note)?;
        self.logs.sync()?;
        self.folder.sync(&[Provenance::FILE, LOG])?;
        let (disk, keep) = (self.folder.disk(), self.experiment.checkpoints.keep);
        checkpoints::save(disk, &self.folder.checkpoints(), rollouts, &bytes, keep)?;
        self.saved = Some((rollouts, due));
        Ok(())
    }

    /// The figures of the run. Scores are those of the last evaluation; where there was none since
    /// the start or the resumption, all variants are scored now, unless a [stop](Run::stop_at) is
    /// wished for before they are: then there are no figures. Those of a finished run are written
    /// to `summary.json`, too.
    ///
    /// # Errors
    /// What the evaluation says.
    pub fn summary(&mut self) -> Result<Option<Summary>, RunError> {
        if self.last_scores.is_empty() {
            let rounds = self.experiment.evaluation.rounds;
            let stop = self.stop.clone();
            let Some(findings) = self.scoring(&stop).score(rounds, 0)? else {
                return Ok(None);
            };
            self.last_scores = findings.scores;
        }
        let ledger = &self.ledger;
        let summary = Summary {
            decisions: ledger.decisions,
            seconds: ledger.seconds,
            decisions_per_second: self.logs.timings().decisions_per_second(),
            policies: self.learner.policies(),
            merged: ledger.merged(),
            failures: ledger.failures,
            straddled: ledger.straddled,
            assignment_accuracy: ledger.accuracy(),
            return_accuracy: ledger.return_accuracy(),
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
