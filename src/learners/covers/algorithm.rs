//! Algorithm 1 of the paper: collect, assign, update. Read this file from top to bottom.
//!
//! Liu, Xu, Huang, Zhang, Liu, Oguchi, Zhao, "Continual Vision-based Reinforcement Learning with
//! Group Symmetries", CoRL 2023. Where the paper leaves a gap, the setting that closes it says so.

use std::path::Path;
use std::time::Instant;

use cluster::{Assignment, Decision, Evidence, PermutationTest, Reservoir};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Algorithm, EnvSpec, Metrics as _, Ppo, RolloutBuffer, RolloutState,
    RolloutStats, UpdateStats, VectorEnv, collect,
};

use crate::error::CoversError;
use crate::groupings::Grouping;
use crate::learners::learner::{Extent, Learner, Seconds, Turn};
use crate::learners::metrics::Metrics;

use super::first_frames::{FirstFrames, first_frames, keep_features};
use super::member::{Clouds, Generators, Member};
use super::settings::{CoversSettings, Embedding, Handover, NewPolicy};

type Answer = Result<Assignment, CoversError>;

/// The learner: a growing collection of policies. It has no place for a task label.
pub struct Covers {
    pub(super) settings: CoversSettings,
    pub(super) spec: EnvSpec,
    pub(super) grouping: Box<dyn Grouping>,
    pub(super) members: Vec<Member>,
    pub(super) current: usize,
    pub(super) rollout: RolloutBuffer,
    pub(super) generators: Generators,
    pub(super) seconds: Seconds,
}

impl Learner for Covers {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    /// One turn of Algorithm 1: roll out, assign, update.
    fn learn(&mut self, env: &mut dyn VectorEnv) -> Result<Turn, CoversError> {
        self.seconds = Seconds::default();
        let collector = self.current;
        let mut stats = self.roll_out(env)?;
        let mut decisions = stats.decisions;
        let mut frames = self.first_frames()?;
        let mut assignment = self.assign(&frames)?;
        let mut first_look = None;
        // the paper opens a policy on a single rollout
        if assignment.decision == Decision::Undecided {
            stats = self.roll_out(env)?;
            decisions += stats.decisions;
            frames.extend(self.first_frames()?);
            first_look = Some(assignment.evidence);
            assignment = self.settle(&frames)?;
        }
        let created = self.adopt(&assignment, frames)?;
        // the paper does not say that a rollout that changes hands is off-policy
        if self.current != collector {
            match self.settings.handover {
                Handover::CollectAgain => {
                    stats = self.roll_out(env)?;
                    decisions += stats.decisions;
                }
                Handover::Reuse => {
                    let policy = &mut self.members[self.current].policy;
                    self.rollout.revalue(policy)?;
                }
            }
        }
        let update = self.update()?;
        Ok(Turn {
            policy: self.current,
            created,
            metrics: metrics(&assignment.evidence, first_look.is_some(), &update),
            evidence: assignment.evidence,
            first_look,
            decisions,
            rollout: stats,
            seconds: self.seconds,
        })
    }

    /// Looks at the first frames of as many episodes as the grouping needs, at least one in each
    /// environment. Where the grouping accepts no policy, the nearest one answers.
    fn recognise(
        &mut self,
        env: &mut dyn VectorEnv,
        rng: &mut ChaCha8Rng,
    ) -> Result<usize, CoversError> {
        let k = self.settings.first_frames;
        let mut glimpse = RolloutBuffer::new(env.spec(), k)?;
        let mut frames = Vec::new();
        while frames.len() < self.grouping.min_episodes() {
            let policy = &mut self.members[self.current].policy;
            let mut state = RolloutState::reset(env, policy)?;
            collect(env, policy, &mut glimpse, &mut state, rng)?;
            let seen = first_frames(&glimpse, k);
            if seen.is_empty() {
                return self.check_episodes(0).map(|()| self.current);
            }
            frames.extend(seen);
        }
        let mut clouds = Clouds {
            members: &mut self.members,
            rollout: &frames,
        };
        let assignment = self.grouping.assign(&mut clouds, rng)?;
        Ok(match assignment.decision {
            Decision::Existing(index) => index,
            Decision::New | Decision::Undecided => assignment.nearest().unwrap_or(0),
        })
    }

    fn perform(
        &mut self,
        index: usize,
        env: &mut dyn VectorEnv,
        rounds: usize,
    ) -> Result<RolloutStats, CoversError> {
        let member = self
            .members
            .get_mut(index)
            .ok_or_else(|| CoversError::Setting {
                name: "policy",
                value: index.to_string(),
                expected: "the index of a policy that was created",
            })?;
        Ok(rl::evaluate(env, &mut member.policy, rounds)?)
    }

    fn policies(&self) -> usize {
        self.members.len()
    }

    fn save(&self, path: &Path, extent: Extent, note: &str) -> Result<(), CoversError> {
        self.write(path, extent, note)
    }
}

impl Covers {
    /// A learner with one random policy and no frames, and the grouping that the settings name.
    ///
    /// # Errors
    /// A setting out of range, a grouping that needs labels, or an image size that the network
    /// cannot keep exactly symmetric.
    pub fn new(settings: CoversSettings, spec: &EnvSpec) -> Result<Self, CoversError> {
        let grouping = settings.grouping.build()?;
        Self::with_grouping(settings, spec, grouping)
    }

    /// The same with a grouping of the caller's.
    ///
    /// # Errors
    /// A setting out of range, or an image size that the network cannot keep exactly symmetric.
    pub fn with_grouping(
        settings: CoversSettings,
        spec: &EnvSpec,
        grouping: Box<dyn Grouping>,
    ) -> Result<Self, CoversError> {
        let steps = settings.steps_per_env(spec, grouping.min_episodes())?;
        let mut covers = Self {
            spec: spec.clone(),
            grouping,
            members: Vec::new(),
            current: 0,
            rollout: RolloutBuffer::new(spec, steps)?,
            generators: Generators::new(settings.seed),
            seconds: Seconds::default(),
            settings,
        };
        covers.open_policy(None)?;
        Ok(covers)
    }

    /// Collects `N_s` decisions with the current policy.
    fn roll_out(&mut self, env: &mut dyn VectorEnv) -> Result<RolloutStats, CoversError> {
        let clock = Instant::now();
        let policy = &mut self.members[self.current].policy;
        let mut state = RolloutState::reset(env, policy)?;
        let (buffer, rng) = (&mut self.rollout, &mut self.generators.actions);
        let stats = collect(env, policy, buffer, &mut state, rng)?;
        self.seconds.collection += clock.elapsed().as_secs_f64();
        Ok(stats)
    }

    /// The first frames of the rollout's episodes.
    fn first_frames(&self) -> Result<Vec<FirstFrames>, CoversError> {
        let frames = first_frames(&self.rollout, self.settings.first_frames);
        self.check_episodes(frames.len())?;
        Ok(frames)
    }

    /// Refuses a rollout that shows too few first frames to be assigned.
    fn check_episodes(&self, got: usize) -> Result<(), CoversError> {
        let needed = self.grouping.min_episodes();
        if got >= needed {
            return Ok(());
        }
        Err(CoversError::TooFewEpisodes {
            got,
            needed,
            first_frames: self.settings.first_frames,
        })
    }

    /// Asks the grouping whose rollout it was.
    fn assign(&mut self, frames: &[FirstFrames]) -> Answer {
        self.ask(frames, |grouping, clouds, rng| grouping.assign(clouds, rng))
    }

    /// Asks it again, for good, with the frames of two rollouts.
    fn settle(&mut self, frames: &[FirstFrames]) -> Answer {
        self.ask(frames, |grouping, clouds, rng| grouping.settle(clouds, rng))
    }

    fn ask(
        &mut self,
        rollout: &[FirstFrames],
        question: impl Fn(&dyn Grouping, &mut Clouds, &mut ChaCha8Rng) -> Answer,
    ) -> Answer {
        let clock = Instant::now();
        let members = &mut self.members;
        let mut clouds = Clouds { members, rollout };
        let rng = &mut self.generators.assignment;
        let answer = question(&*self.grouping, &mut clouds, rng);
        self.seconds.assignment += clock.elapsed().as_secs_f64();
        answer
    }

    /// Makes the assigned policy current and gives it the frames; returns whether it is new.
    fn adopt(
        &mut self,
        assignment: &Assignment,
        mut frames: Vec<FirstFrames>,
    ) -> Result<bool, CoversError> {
        let policies = self.members.len();
        self.current = match (assignment.decision, self.settings.new_policy) {
            (Decision::Existing(index), _) => index,
            (_, NewPolicy::Random) => self.open_policy(None)?,
            (_, NewPolicy::Copy) => self.open_policy(assignment.nearest())?,
        };
        self.grouping.adopt(self.current);
        let member = &mut self.members[self.current];
        if self.settings.embedding == Embedding::AtArrival {
            keep_features(&mut member.policy, &mut frames)?;
        }
        for episode in frames {
            member
                .buffer
                .offer(episode, &mut self.generators.assignment);
        }
        Ok(self.current == policies)
    }

    /// Improves the current policy by the rollout.
    fn update(&mut self) -> Result<UpdateStats, CoversError> {
        let clock = Instant::now();
        let Member { policy, ppo, .. } = &mut self.members[self.current];
        let stats = ppo.update(policy, &self.rollout, &mut self.generators.updates)?;
        self.seconds.update += clock.elapsed().as_secs_f64();
        Ok(stats)
    }

    /// Adds a policy with an empty buffer, random or with the parameters of `parent`; returns its
    /// index.
    fn open_policy(&mut self, parent: Option<usize>) -> Result<usize, CoversError> {
        let policy = match parent {
            Some(parent) => self.members[parent].policy.clone(),
            None => {
                let seed = self.generators.initialisation.random();
                ActorCriticPolicy::new(&self.settings.network, &self.spec, seed)?
            }
        };
        let ppo = Ppo::new(self.settings.ppo.clone(), &policy)?;
        let buffer = Reservoir::new(self.settings.buffer_capacity())?;
        self.members.push(Member {
            policy,
            ppo,
            buffer,
        });
        Ok(self.members.len() - 1)
    }

    /// Episodes whose first frames policy `index` keeps, the size of its `B`; `None` for a policy
    /// that does not exist.
    pub fn buffered_episodes(&self, index: usize) -> Option<usize> {
        let member = self.members.get(index)?;
        Some(member.buffer.episodes().len())
    }
}

/// What is logged: the evidence of the grouping, one number for each policy, and the update.
fn metrics(evidence: &[Evidence], second_look: bool, update: &UpdateStats) -> Metrics {
    let mut metrics = Metrics::default();
    metrics.number("looks", 1.0 + f64::from(u8::from(second_look)));
    metrics.per_policy("distances", evidence.iter().map(|e| Some(e.distance)));
    type Figure = fn(&PermutationTest) -> f64;
    let figures: [(&str, Figure); 5] = [
        ("null_means", |test| test.null.mean),
        ("null_maxima", |test| test.null.max),
        ("scores", |test| test.score),
        ("p_values", |test| test.p_value),
        ("tail_p_values", |test| test.tail_p_value),
    ];
    for (name, figure) in figures {
        metrics.per_policy(name, evidence.iter().map(|e| e.test().map(figure)));
    }
    for (name, value) in update.metrics() {
        metrics.number(name, value);
    }
    metrics
}
