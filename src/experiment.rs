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
use crate::{Covers, CoversError, CoversSettings};

/// Random streams of the experiment, counted from the top: the learner's are counted from 0 under the same seed.
const SCHEDULE: u64 = u64::MAX;
const ENVIRONMENTS: u64 = u64::MAX - 1;
const EVALUATION: u64 = u64::MAX - 2;

/// Settings of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Experiment {
    /// The learner; its seed is the seed of the whole run.
    pub covers: CoversSettings,
    /// The environments; `threads` counts for the learner, too, and `seed` is drawn from the run's.
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
        experiment.envs.dynamics.horizon = 100;
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
            rollouts: [10, 5, 14, 5],
            evaluation_rounds: 2,
        }
    }

    /// About twenty minutes on two cores: every group three times, and more of the two that take longer.
    pub fn full() -> Self {
        Self {
            cycles: 3,
            rollouts: [8, 30, 12, 50],
            evaluation_rounds: 5,
            ..Self::short()
        }
    }

    /// The same run with another seed.
    pub fn with_seed(mut self, seed: u64) -> Self {
        self.covers.seed = seed;
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

    /// Refuses a run that could not be finished.
    ///
    /// # Errors
    /// [`CoversError::Setting`] or [`CoversError::Env`] for the first setting that is out of range.
    pub fn check(&self) -> Result<(), CoversError> {
        let at_least_one = [
            ("cycles", self.cycles),
            ("rollouts", self.rollouts.into_iter().min().unwrap_or(0)),
            ("evaluation_rounds", self.evaluation_rounds),
        ];
        for (name, value) in at_least_one {
            if value == 0 {
                return Err(CoversError::Setting {
                    name,
                    value: value.to_string(),
                    expected: "at least 1",
                });
            }
        }
        Ok(self.envs.check()?)
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
    /// Failures of single environments while learning, see [`Stream::failures`].
    pub failures: usize,
    /// Share of rollouts assigned to the first policy that was opened for their group, in `[0, 1]`.
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
    experiment.check()?;
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
    let envs = VecEnvSettings {
        seed: stream_rng(experiment, ENVIRONMENTS).random(),
        ..experiment.envs
    };
    let mut stream = Stream::new(envs, visits[0].group)?;
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
        failures: stream.failures(),
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
            log.record(visit.group, report.policy, report.decisions);
            let entry = Progress {
                rollout: log.rollouts - 1,
                decisions: log.decisions,
                group: visit.group,
                reward: report
                    .rollout
                    .mean_return()
                    .map(|sum| sum * stream.reward_scale()),
                success: report.rollout.success_rate(),
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
    let mut rng = ChaCha8Rng::seed_from_u64(experiment.covers.seed);
    rng.set_stream(stream);
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
    fn record(&mut self, group: TaskGroup, policy: usize, decisions: usize) {
        if policy == self.opened_for.len() {
            self.opened_for.push(group);
        }
        self.rollouts += 1;
        self.decisions += decisions;
        let first = self.opened_for.iter().position(|&opened| opened == group);
        self.right += usize::from(first == Some(policy));
    }

    fn accuracy(&self) -> f64 {
        self.right as f64 / self.rollouts.max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn accuracy(rollouts: &[(TaskGroup, usize)]) -> f64 {
        let mut log = AssignmentLog::default();
        for &(group, policy) in rollouts {
            log.record(group, policy, 1000);
        }
        assert_eq!(log.decisions, 1000 * rollouts.len());
        log.accuracy()
    }

    #[test]
    fn a_policy_for_each_group_is_right() {
        use TaskGroup::{ButtonPress as B, DrawerClose as D};
        assert_eq!(accuracy(&[(B, 0), (B, 0), (D, 1), (B, 0), (D, 1)]), 1.0);
    }

    #[test]
    fn mixing_groups_and_splitting_a_group_are_both_wrong() {
        use TaskGroup::{ButtonPress as B, DrawerClose as D};
        assert_eq!(accuracy(&[(B, 0), (D, 0), (D, 0), (B, 0)]), 0.5);
        assert_eq!(accuracy(&[(B, 0), (B, 1), (B, 2), (B, 3)]), 0.25);
    }

    #[test]
    fn no_two_purposes_share_a_random_stream() {
        let experiment = Experiment::smoke().with_seed(7);
        let first_words = |rng: ChaCha8Rng| -> [u64; 2] {
            let mut rng = rng;
            [rng.random(), rng.random()]
        };
        let environments = stream_rng(&experiment, ENVIRONMENTS).random();
        let learner = (0..4).map(|stream| stream_rng(&experiment, stream));
        let own =
            [SCHEDULE, ENVIRONMENTS, EVALUATION].map(|stream| stream_rng(&experiment, stream));
        let slots = (0..20).map(|stream| {
            let mut rng = ChaCha8Rng::seed_from_u64(environments);
            rng.set_stream(stream);
            rng
        });
        let all: Vec<_> = learner.chain(own).chain(slots).map(first_words).collect();
        let different: std::collections::HashSet<_> = all.iter().collect();
        assert_eq!(different.len(), all.len());
    }

    #[test]
    fn runs_that_could_not_finish_are_refused() {
        let broken = [
            Experiment {
                cycles: 0,
                ..Experiment::smoke()
            },
            Experiment {
                rollouts: [2, 0, 2, 2],
                ..Experiment::smoke()
            },
            Experiment {
                evaluation_rounds: 0,
                ..Experiment::smoke()
            },
            Experiment::smoke().with_threads(0),
        ];
        for experiment in broken {
            assert!(experiment.check().is_err(), "{experiment:?}");
        }
        assert!(Experiment::smoke().check().is_ok());
    }
}
