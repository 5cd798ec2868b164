//! One run over a stream, from the first rollout to the final scores; it can stop anywhere and go
//! on later.

use std::path::Path;
use std::time::Instant;

use envs::TaskRegistry;
use rayon::ThreadPool;
use serde::{Deserialize, Serialize};

use crate::error::CoversError;
use crate::evaluation::{Evaluator, GroupScore, Score, by_group};
use crate::experiment::Experiment;
use crate::groupings::Labels;
use crate::learners::{Extent, Learner};
use crate::ledger::Ledger;
use crate::logs::{Logs, Marks};
use crate::progress::Progress;
use crate::run_folder::RunFolder;
use crate::schedule::Visit;
use crate::sheet::contact_sheet;
use crate::stream::Stream;

/// Figures of a whole run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Decisions taken while learning.
    pub decisions: usize,
    /// Wall-clock seconds of learning, without evaluations.
    pub seconds: f64,
    /// Decisions per second of learning.
    pub decisions_per_second: f64,
    /// Policies created.
    pub policies: usize,
    /// Failures of single environments while learning, see [`Stream::failures`].
    pub failures: usize,
    /// Share of rollouts assigned to the first policy that was opened for their group, in `[0, 1]`.
    pub assignment_accuracy: f64,
    /// The same share among rollouts of groups that came back.
    pub return_accuracy: f64,
    /// Scores of the groups after the stream.
    pub groups: Vec<GroupScore>,
    /// Scores of all their variants.
    pub variants: Vec<Score>,
}

/// What a checkpoint says beside the learner itself.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Note {
    ledger: Ledger,
    marks: Marks,
}

/// A run in progress.
pub struct Run {
    experiment: Experiment,
    folder: RunFolder,
    logs: Logs,
    pool: ThreadPool,
    tasks: TaskRegistry,
    visits: Vec<Visit>,
    stream: Stream,
    evaluator: Evaluator,
    learner: Box<dyn Learner>,
    labels: Labels,
    ledger: Ledger,
    last_scores: Vec<Score>,
}

impl Run {
    /// Begins a run over the paper's task groups that writes its files to `folder`.
    ///
    /// # Errors
    /// A setting out of range; what the environments or the file system say.
    pub fn start(experiment: Experiment, folder: RunFolder) -> Result<Self, CoversError> {
        Self::start_with(experiment, TaskRegistry::standard(), folder)
    }

    /// Begins a run over groups of `tasks`.
    ///
    /// # Errors
    /// A setting out of range, or a group that `tasks` does not hold; what the environments or the
    /// file system say.
    pub fn start_with(
        experiment: Experiment,
        tasks: TaskRegistry,
        folder: RunFolder,
    ) -> Result<Self, CoversError> {
        experiment.check(&tasks)?;
        let groups = experiment.schedule.resolve(&tasks)?;
        folder.write_experiment(&experiment)?;
        // First of all, while the process has one thread: loading a model tunes software rendering
        // by an environment variable.
        let sheet = contact_sheet(&experiment.envs, &groups)?;
        folder.write_png("contact_sheet.png", &sheet)?;
        let (spec, labels) = (Stream::spec_of(&experiment.envs), Labels::default());
        let learner = experiment.learner.start(&spec, &labels)?;
        Self::assemble(experiment, tasks, folder, learner, labels, None)
    }

    /// Goes on from the last checkpoint of the run in `folder`, to the same files byte for byte,
    /// timings aside.
    ///
    /// # Errors
    /// [`CoversError::Read`] where the folder holds no run or a damaged one,
    /// [`CoversError::PoliciesOnly`] where it is a packed one; what the environments say.
    pub fn resume(folder: &Path, threads: Option<usize>) -> Result<Self, CoversError> {
        Self::resume_with(folder, threads, TaskRegistry::standard())
    }

    /// As [`Run::resume`], for a run over groups of `tasks`.
    ///
    /// # Errors
    /// As there, and a group that `tasks` does not hold.
    pub fn resume_with(
        folder: &Path,
        threads: Option<usize>,
        tasks: TaskRegistry,
    ) -> Result<Self, CoversError> {
        let folder = RunFolder::open(folder);
        let mut experiment = folder.experiment()?;
        experiment.envs.threads = threads.unwrap_or(experiment.envs.threads);
        experiment.check(&tasks)?;
        let (spec, labels) = (Stream::spec_of(&experiment.envs), Labels::default());
        let checkpoint = folder.checkpoint();
        let (learner, note) = experiment.learner.resume(&checkpoint, &spec, &labels)?;
        let note: Note =
            serde_json::from_str(&note).map_err(|error| CoversError::read(&checkpoint, error))?;
        Self::assemble(experiment, tasks, folder, learner, labels, Some(note))
    }

    fn assemble(
        experiment: Experiment,
        tasks: TaskRegistry,
        folder: RunFolder,
        learner: Box<dyn Learner>,
        labels: Labels,
        note: Option<Note>,
    ) -> Result<Self, CoversError> {
        let (envs, schedule) = (experiment.envs, experiment.schedule.clone());
        let seed = experiment.evaluation_seed();
        let (ledger, marks) = note.map_or_else(Default::default, |n| (n.ledger, Some(n.marks)));
        // environments before threads: the first model of a process tunes software rendering
        let stream = Stream::new(envs, &schedule.resolve(&tasks)?)?;
        let evaluator = Evaluator::new(envs, &tasks, schedule, seed, labels.clone())?;
        Ok(Self {
            visits: experiment.visits(),
            experiment,
            pool: thread_pool(envs.threads)?,
            tasks,
            stream,
            evaluator,
            // last: where anything else fails, no rows are cut off
            logs: folder.logs(marks)?,
            folder,
            learner,
            labels,
            ledger,
            last_scores: Vec::new(),
        })
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

    /// Learns from one more rollout, evaluates and saves where that is due; nothing is left to do
    /// where there is no progress.
    ///
    /// # Errors
    /// What any part says; files written so far stay, and the last checkpoint can be resumed.
    pub fn advance(&mut self) -> Result<Option<Progress>, CoversError> {
        let Some((index, nth)) = locate(&self.visits, self.ledger.rollouts) else {
            return Ok(None);
        };
        let mut progress = self.learn(index)?;
        let last_of_visit = nth + 1 == self.visits[index].rollouts;
        let last = last_of_visit && index + 1 == self.visits.len();
        let rounds = self.evaluation_rounds(last_of_visit, last);
        if rounds > 0 {
            progress.scores = self.evaluate(rounds)?;
            self.logs.write_scores(&progress)?;
            self.last_scores.clone_from(&progress.scores);
        }
        let every = self.experiment.checkpoint_every;
        if last || self.ledger.rollouts.is_multiple_of(every) {
            self.save()?;
        }
        Ok(Some(progress))
    }

    /// Rounds of the evaluation that is due after this rollout; 0 for none.
    fn evaluation_rounds(&self, last_of_visit: bool, last: bool) -> usize {
        let plan = &self.experiment.evaluation;
        match (last, last_of_visit) {
            (true, _) => plan.rounds,
            (false, true) => plan.visit_rounds,
            (false, false) => plan.within_visit(self.ledger.rollouts),
        }
    }

    /// One turn of the learner in the visit of this index.
    fn learn(&mut self, index: usize) -> Result<Progress, CoversError> {
        let clock = Instant::now();
        let (visit, rollout) = (&self.visits[index], self.ledger.rollouts);
        let group = self.tasks.get(&visit.group)?;
        let returns = self.visits[..index].iter().any(|v| v.group == visit.group);
        let (learner, stream) = (&mut self.learner, &mut self.stream);
        stream.switch_to(group, &visit.variants)?;
        stream.reseed(self.experiment.environment_seed(rollout))?;
        self.labels.set(group.name());
        let (failures, environment_seconds) = (stream.failures(), stream.seconds());
        let turn = self.pool.install(|| learner.learn(stream))?;
        let seconds = clock.elapsed().as_secs_f64();
        let ledger = &mut self.ledger;
        ledger.record(group.name(), returns, turn.policy);
        ledger.decisions += turn.decisions;
        ledger.failures += stream.failures() - failures;
        ledger.seconds += seconds;
        let reward = turn.rollout.mean_return();
        let progress = Progress {
            rollout,
            decisions: ledger.decisions,
            group,
            reward: reward.map(|sum| sum * stream.reward_scale()),
            success: turn.rollout.success_rate(),
            turn,
            seconds,
            environment_seconds: stream.seconds() - environment_seconds,
            scores: Vec::new(),
        };
        self.logs.write_rollout(&progress)?;
        Ok(progress)
    }

    /// Scores all variants of all groups now, with `rounds` episodes in each environment.
    ///
    /// # Errors
    /// What the evaluation says.
    pub fn evaluate(&mut self, rounds: usize) -> Result<Vec<Score>, CoversError> {
        let (learner, evaluator) = (&mut *self.learner, &mut self.evaluator);
        self.pool.install(|| evaluator.all(learner, rounds))
    }

    /// Writes a checkpoint over the last one.
    fn save(&mut self) -> Result<(), CoversError> {
        let path = self.folder.checkpoint();
        let note = Note {
            ledger: self.ledger.clone(),
            marks: self.logs.marks()?,
        };
        let note = serde_json::to_string(&note).map_err(|e| CoversError::write(&path, e))?;
        self.learner.save(&path, Extent::Everything, &note)
    }

    /// The figures of the run. Scores are those of the last evaluation; where there was none since
    /// the start or the resumption, all variants are scored now.
    ///
    /// # Errors
    /// What the evaluation says.
    pub fn summary(&mut self) -> Result<Summary, CoversError> {
        if self.last_scores.is_empty() {
            self.last_scores = self.evaluate(self.experiment.evaluation.rounds)?;
        }
        let ledger = &self.ledger;
        Ok(Summary {
            decisions: ledger.decisions,
            seconds: ledger.seconds,
            decisions_per_second: ledger.decisions as f64 / ledger.seconds,
            policies: self.learner.policies(),
            failures: ledger.failures,
            assignment_accuracy: ledger.accuracy(),
            return_accuracy: ledger.return_accuracy(),
            groups: by_group(&self.last_scores),
            variants: self.last_scores.clone(),
        })
    }
}

/// The threads that networks run on.
pub(crate) fn thread_pool(threads: usize) -> Result<ThreadPool, CoversError> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|source| CoversError::Threads { threads, source })
}

/// The visit that a rollout belongs to, and its number within the visit; none behind the last.
fn locate(visits: &[Visit], rollout: usize) -> Option<(usize, usize)> {
    let mut before = 0;
    for (index, visit) in visits.iter().enumerate() {
        if rollout < before + visit.rollouts {
            return Some((index, rollout - before));
        }
        before += visit.rollouts;
    }
    None
}
