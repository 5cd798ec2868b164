//! One run over a stream, from the first rollout to the final scores.

use std::time::Instant;

use envs::{Embodiment, TaskGroup, VecEnvSettings};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::evaluation::{Score, evaluate};
use crate::progress::Progress;
use crate::run_folder::RunFolder;
use crate::sheet::contact_sheet;
use crate::stream::{Stream, Visit, schedule};
use crate::{Covers, CoversError, CoversSettings, Report};

/// Random streams of the experiment.
const SCHEDULE: u64 = 0;
const EVALUATION: u64 = 1;

/// Settings of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Experiment {
    /// The learner.
    pub covers: CoversSettings,
    /// The environments; `threads` counts for the learner, too.
    pub envs: VecEnvSettings,
    /// Times that every group comes by.
    pub cycles: usize,
    /// Rollouts of one visit of each of [`TaskGroup::ALL`].
    pub rollouts: [usize; 4],
    /// Evaluation episodes in each environment and group.
    pub evaluation_rounds: usize,
}

impl Experiment {
    /// Seconds: a few decisions of everything, to see that all parts work. Nothing is learnt.
    pub fn smoke() -> Self {
        let mut experiment = Self::short();
        experiment.envs.num_envs = 8;
        experiment.covers.rollout_steps = 8 * 10;
        experiment.covers.ppo.epochs = 1;
        experiment.cycles = 1;
        experiment.rollouts = [2; 4];
        experiment.evaluation_rounds = 1;
        experiment
    }

    /// Minutes: learns Goal Reach and Drawer Close, and tells all four groups apart.
    pub fn short() -> Self {
        Self {
            covers: CoversSettings::default(),
            envs: VecEnvSettings::default(),
            cycles: 2,
            rollouts: [8, 5, 14, 5],
            evaluation_rounds: 2,
        }
    }

    /// About an hour: every group three times, with the decisions that a feasibility study found each to need.
    pub fn full() -> Self {
        Self {
            cycles: 3,
            rollouts: [6, 24, 12, 40],
            evaluation_rounds: 5,
            ..Self::short()
        }
    }

    /// The same run with another seed.
    pub fn with_seed(mut self, seed: u64) -> Self {
        self.covers.seed = seed;
        self.envs.seed = seed;
        self
    }

    /// The same run on `threads` threads; results do not depend on them.
    pub fn with_threads(mut self, threads: usize) -> Self {
        self.envs.threads = threads;
        self
    }

    /// The same run with another embodiment.
    pub fn with_embodiment(mut self, embodiment: Embodiment) -> Self {
        self.envs.embodiment = embodiment;
        self
    }

    /// Rollouts of the whole stream.
    pub fn total_rollouts(&self) -> usize {
        self.cycles * self.rollouts.iter().sum::<usize>()
    }
}

/// Figures of a whole run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Decisions taken while learning.
    pub decisions: usize,
    /// Wall-clock seconds of learning, without the evaluation.
    pub seconds: f64,
    /// Decisions per second of learning.
    pub decisions_per_second: f64,
    /// Policies created.
    pub policies: usize,
    /// Share of rollouts assigned to a policy that was opened for their group, in `[0, 1]`; the first visit's opening counts as right.
    pub assignment_accuracy: f64,
    /// Scores of the four groups after the stream.
    pub groups: Vec<Score>,
}

/// Runs `experiment`, writes its files to `folder`, and calls `progress` after each rollout.
///
/// # Errors
/// What any part says; files written so far stay.
pub fn run(
    experiment: &Experiment,
    folder: &RunFolder,
    progress: &mut (dyn FnMut(&Progress) + Send),
) -> Result<Summary, CoversError> {
    // First of all, while the process has one thread: loading a model tunes software rendering by an environment variable.
    folder.write_png("contact_sheet.png", &contact_sheet(&experiment.envs)?)?;
    let threads = experiment.envs.threads;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|source| CoversError::Threads { threads, source })?;
    pool.install(|| run_here(experiment, folder, progress))
}

fn run_here(
    experiment: &Experiment,
    folder: &RunFolder,
    progress: &mut (dyn FnMut(&Progress) + Send),
) -> Result<Summary, CoversError> {
    let mut rng = stream_rng(experiment, SCHEDULE);
    let visits = schedule(experiment.cycles, experiment.rollouts, &mut rng);
    let mut stream = Stream::new(experiment.envs, visits[0].group)?;
    let mut covers = Covers::new(experiment.covers.clone(), rl::VectorEnv::spec(&stream))?;
    let clock = Instant::now();
    let log = learn_stream(&mut covers, &mut stream, &visits, folder, progress)?;
    let seconds = clock.elapsed().as_secs_f64();
    let groups = evaluate_all(experiment, &mut covers)?;
    folder.write_scores(&groups)?;
    Ok(Summary {
        decisions: log.decisions,
        seconds,
        decisions_per_second: log.decisions as f64 / seconds,
        policies: covers.policies(),
        assignment_accuracy: log.accuracy(),
        groups,
    })
}

/// Learns from visit after visit; the learner is handed the environments and nothing else.
fn learn_stream(
    covers: &mut Covers,
    stream: &mut Stream,
    visits: &[Visit],
    folder: &RunFolder,
    progress: &mut (dyn FnMut(&Progress) + Send),
) -> Result<AssignmentLog, CoversError> {
    let mut metrics = folder.metrics()?;
    let mut log = AssignmentLog::default();
    for visit in visits {
        stream.switch_to(visit.group)?;
        for _ in 0..visit.rollouts {
            let report = covers.learn(stream)?;
            log.record(visit.group, &report);
            let entry = Progress {
                rollout: log.rollouts - 1,
                decisions: log.decisions,
                group: visit.group,
                reward: report.rollout.mean_return().unwrap_or(0.0) * stream.reward_scale(),
                success: report.rollout.success_rate().unwrap_or(0.0),
                report,
            };
            metrics.write(&entry)?;
            progress(&entry);
        }
    }
    Ok(log)
}

fn evaluate_all(experiment: &Experiment, covers: &mut Covers) -> Result<Vec<Score>, CoversError> {
    let mut rng = stream_rng(experiment, EVALUATION);
    let envs = VecEnvSettings {
        seed: rng.random(),
        ..experiment.envs
    };
    let mut stream = Stream::new(envs, TaskGroup::ALL[0])?;
    TaskGroup::ALL
        .into_iter()
        .map(|group| {
            let rounds = experiment.evaluation_rounds;
            evaluate(covers, &mut stream, group, rounds, &mut rng)
        })
        .collect()
}

fn stream_rng(experiment: &Experiment, stream: u64) -> ChaCha8Rng {
    // The learner's streams start from the same seed: these are numbered from the other end.
    let mut rng = ChaCha8Rng::seed_from_u64(experiment.covers.seed);
    rng.set_stream(u64::MAX - stream);
    rng
}

/// Which policy was opened for which group, and how often the right one was assigned.
#[derive(Debug, Default)]
struct AssignmentLog {
    opened_for: Vec<TaskGroup>,
    rollouts: usize,
    decisions: usize,
    right: usize,
}

impl AssignmentLog {
    fn record(&mut self, group: TaskGroup, report: &Report) {
        if report.policy == self.opened_for.len() {
            self.opened_for.push(group);
        }
        self.rollouts += 1;
        self.decisions += report.decisions;
        self.right += usize::from(self.opened_for.get(report.policy) == Some(&group));
    }

    fn accuracy(&self) -> f64 {
        self.right as f64 / self.rollouts.max(1) as f64
    }
}
