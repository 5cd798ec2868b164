//! Stream of drawn tasks, the learner that watches it, and records of what happens.

use cluster::{PolicyEvidence, PolicyVerdict};
use evidence::RecogniserSettings;
use learner::{CoversLearner, CoversSettings, GroupingSettings, Learner, LearnerError};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{
    BoxedEnvError, CriticSettings, EnvSpec, NetworkSettings, Observations, PpoSettings, RlError,
    Transition, VectorEnv,
};
use serde::Serialize;
use symmetry::D2;
use worlds::{GroupVisit, StreamError, TaskStream, World, WorldKind};

/// Number of environments that step together.
const NUM_ENVS: usize = 20;
/// Number of environments whose pictures are recorded.
pub const NUM_FILMED_ENVS: usize = 4;
/// Number of decisions of an episode.
const HORIZON: usize = 25;

/// Stream that records the pictures of its first environments.
struct FilmedStream {
    stream: TaskStream,
    film: Vec<u8>,
}

impl FilmedStream {
    fn record(&mut self, images: &[u8]) {
        let len = self.stream.spec().image_len() * NUM_FILMED_ENVS;
        self.film.extend(present(&images[..len]));
    }
}

impl VectorEnv for FilmedStream {
    fn spec(&self) -> &EnvSpec {
        self.stream.spec()
    }

    fn horizon(&self) -> Option<usize> {
        self.stream.horizon()
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        self.stream.reset(out)?;
        // only the last rollout of an iteration is shown
        self.film.clear();
        self.record(&out.images);
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        self.stream.step(actions, out)?;
        // episodes end together, and observations are then those of the next ones
        let is_last = out.outcomes[0].is_ended();
        let shown = if is_last { &out.final_observations } else { &out.observations };
        self.record(&shown.images);
        Ok(())
    }
}

/// Demonstration: a learner, and the stream of tasks that it trains on.
pub struct WorldsDemo {
    env: FilmedStream,
    learner: CoversLearner,
    iterations: usize,
}

/// Record of one iteration of learning.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IterationRecord {
    /// Number of the iteration, from 0.
    pub iteration: usize,
    /// True group of the last episodes, which the learner is not told.
    pub group: usize,
    /// Index of the policy that trained.
    pub policy: usize,
    /// `true` if that policy is new.
    pub is_new: bool,
    /// Share of successful episodes, in [0, 1].
    pub success: f64,
    /// Comparison of the rollout with each policy; empty where nothing was compared.
    pub comparisons: Vec<PolicyComparison>,
    /// Chance below which images or motion reject a policy ([`PolicyComparison::chance`]), in
    /// (0, 1); large losses of return need less certainty.
    pub rejection_limit: f64,
    /// Policy that each policy was merged into, if any.
    pub merged_into: Vec<Option<usize>>,
}

/// Comparison of a rollout with the episodes that a policy remembers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PolicyComparison {
    /// 1-Wasserstein distance between image features of the rollout and of the remembered episodes.
    pub distance: f64,
    /// Probability that episodes of one group differ as much as the rollout and the remembered
    /// ones, in [0, 1]; missing where the policy was not tested.
    pub chance: Option<f64>,
    /// Verdict on the policy: "fits", "in doubt" or "rejected".
    pub verdict: &'static str,
}

impl From<&PolicyEvidence> for PolicyComparison {
    fn from(evidence: &PolicyEvidence) -> Self {
        Self {
            distance: evidence.distance,
            chance: evidence.test.map(|test| test.tail_p_value),
            verdict: match evidence.verdict {
                PolicyVerdict::Accepted => "fits",
                PolicyVerdict::Doubted => "in doubt",
                PolicyVerdict::Rejected => "rejected",
            },
        }
    }
}

impl WorldsDemo {
    /// Draws a world and its stream from a seed; the world has `num_groups` groups, at least 1 and
    /// at most 16 whatever is given.
    ///
    /// # Errors
    /// Settings that the learner refuses.
    pub fn new(seed: u64, num_groups: usize) -> Result<Self, LearnerError> {
        let world = World::random_with_num_groups(WorldKind::Appearance, seed, num_groups);
        let visits = draw_visits(seed, world.groups.len());
        let stream =
            TaskStream::new(world, visits, NUM_ENVS).map_err(refused)?.with_horizon(HORIZON);
        let settings = settings(seed);
        let learner = CoversLearner::new(settings, stream.spec())?;
        let env = FilmedStream { stream, film: Vec::new() };
        Ok(Self { env, learner, iterations: 0 })
    }

    /// Runs one iteration of learning.
    ///
    /// # Errors
    /// Errors of the learner.
    pub fn learn(&mut self) -> Result<IterationRecord, LearnerError> {
        let report = self.learner.learn(&mut self.env)?;
        let stream = &self.env.stream;
        let record = IterationRecord {
            iteration: self.iterations,
            group: stream.group_in_round(stream.num_rounds_ended() - 1),
            policy: report.policy,
            is_new: report.policy_created,
            success: report.rollout_stats.success_rate().unwrap_or(0.0),
            comparisons: report.evidence.iter().map(PolicyComparison::from).collect(),
            rejection_limit: RecogniserSettings::default().level,
            merged_into: report.merged_into,
        };
        self.iterations += 1;
        Ok(record)
    }

    /// Returns the images `[T, 4, 48, 48, 3]` of the first four environments in the latest rollout,
    /// at its start and after each decision.
    pub fn rollout_film(&self) -> &[u8] {
        &self.env.film
    }

    /// Returns the first image `[48, 48, 3]` of an episode of a task group.
    ///
    /// # Errors
    /// [`RlError::Environment`] for a group that the world does not have.
    pub fn group_picture(&self, group: usize) -> Result<Vec<u8>, RlError> {
        let visits = vec![GroupVisit { variant: Some(D2::Identity), ..GroupVisit::new(group, 1) }];
        let world = self.env.stream.world().clone();
        let mut stream = TaskStream::new(world, visits, 1).map_err(refused)?;
        let mut observations = Observations::new(stream.spec());
        stream.reset(&mut observations).map_err(RlError::Environment)?;
        Ok(present(&observations.images).collect())
    }

    /// Inserts a visit of `rounds` rollouts to a task group, which begins within two iterations and
    /// ends the visit that it interrupts.
    ///
    /// # Errors
    /// [`RlError::Environment`] for a group that the world does not have, and for 0 rounds.
    pub fn insert_visit(
        &mut self,
        group: usize,
        rounds: usize,
        variant: Option<D2>,
    ) -> Result<(), RlError> {
        self.env.stream.insert_visit(GroupVisit { group, rounds, variant }).map_err(refused)
    }
}

/// Wraps an error of the stream.
fn refused(error: StreamError) -> RlError {
    RlError::Environment(error.into())
}

/// Returns the channels of the present image, which the first image of the episode follows.
fn present(images: &[u8]) -> impl Iterator<Item = u8> {
    images.chunks_exact(6).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]])
}

/// Draws visits of all groups in random order, 8 to 14 rounds each.
fn draw_visits(seed: u64, groups: usize) -> Vec<GroupVisit> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut visits = Vec::new();
    // more than anyone will watch; the last group would stay
    for _ in 0..100 {
        let mut order: Vec<usize> = (0..groups).collect();
        order.shuffle(&mut rng);
        visits.extend(
            order.into_iter().map(|group| GroupVisit::new(group, rng.random_range(8..=14))),
        );
    }
    visits
}

fn settings(seed: u64) -> CoversSettings {
    CoversSettings {
        // half of the default's widths: a browser computes more slowly
        network: NetworkSettings {
            critic: CriticSettings::Joint { fields: 16 },
            ..NetworkSettings::with_strided_encoder(vec![2, 4, 8, 8], 16)
        },
        ppo: PpoSettings {
            // rewards are dense, and episodes have 25 decisions
            gamma: 0.9,
            encoder_learning_rate: 1e-3,
            epochs: 8,
            minibatch: 50,
            ..PpoSettings::default()
        },
        rollout_steps: NUM_ENVS * HORIZON,
        noise_correlation: 0.5,
        grouping: GroupingSettings::Evidence(RecogniserSettings::default()),
        seed,
        ..CoversSettings::default()
    }
}
