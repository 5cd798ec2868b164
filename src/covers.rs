//! Algorithm 1 of the paper: collect, assign, update. Read this file from top to bottom.
//!
//! Liu, Xu, Huang, Zhang, Liu, Oguchi, Zhao, "Continual Vision-based Reinforcement Learning with Group Symmetries",
//! CoRL 2023. Where the paper leaves a gap, the setting that closes it says so.

use std::time::Instant;

use cluster::{Assigner, Assignment, Candidate, Decision, Evidence, Reservoir};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, EnvSpec, Ppo, RolloutBuffer, RolloutState, RolloutStats, UpdateStats,
    VectorEnv, collect,
};
use serde::{Deserialize, Serialize};

use crate::CoversError;
use crate::first_frames::{FirstFrames, embed, first_frames, keep_features, recall};

mod checkpoint;
mod settings;

pub use checkpoint::Extent;
pub use settings::{CoversSettings, Embedding, Handover, NewPolicy};

/// One element of the collection: a policy, its optimiser, and the first frames of the group that it oversees.
struct Member {
    policy: ActorCriticPolicy,
    ppo: Ppo,
    buffer: Reservoir<FirstFrames>,
}

/// Random generators of the learner; each purpose has its own stream, so that none shifts another.
#[derive(Clone, Serialize, Deserialize)]
struct Streams {
    actions: ChaCha8Rng,
    updates: ChaCha8Rng,
    assignment: ChaCha8Rng,
    initialisation: ChaCha8Rng,
}

impl Streams {
    fn new(seed: u64) -> Self {
        let stream = |index| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(index);
            rng
        };
        Self {
            actions: stream(0),
            updates: stream(1),
            assignment: stream(2),
            initialisation: stream(3),
        }
    }
}

/// Whether the assigner may ask for one more rollout.
#[derive(Clone, Copy)]
enum Look {
    First,
    Second,
}

/// What one call of [`Covers::learn`] did.
#[derive(Clone, Debug)]
pub struct Report {
    /// Index of the policy that the rollout was assigned to.
    pub policy: usize,
    /// Whether that policy was created for it.
    pub created: bool,
    /// Evidence of the assignment, one item a policy that existed before.
    pub evidence: Vec<Evidence>,
    /// Evidence of the first look, where it left the assigner undecided and one more rollout was collected: `evidence` is
    /// that of both.
    pub first_look: Option<Vec<Evidence>>,
    /// Decisions taken, discarded ones included.
    pub decisions: usize,
    /// Returns and successes of the rollout that updated the policy.
    pub rollout: RolloutStats,
    /// The update.
    pub update: UpdateStats,
    /// Where the time went.
    pub seconds: Seconds,
}

/// Wall-clock seconds of the parts of Algorithm 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seconds {
    /// Rollouts: the environments and the policy's decisions.
    pub collection: f64,
    /// Features, distances and permutations.
    pub assignment: f64,
    /// The policy update.
    pub update: f64,
}

/// The learner: a growing collection of equivariant policies. It has no place for a task label.
pub struct Covers {
    settings: CoversSettings,
    spec: EnvSpec,
    assigner: Assigner,
    members: Vec<Member>,
    current: usize,
    rollout: RolloutBuffer,
    streams: Streams,
    seconds: Seconds,
}

impl Covers {
    /// A learner with one random policy and an empty collection of frames.
    ///
    /// # Errors
    /// A setting out of range, or an image size that the network cannot keep exactly symmetric.
    pub fn new(settings: CoversSettings, spec: &EnvSpec) -> Result<Self, CoversError> {
        let steps = settings.steps_per_env(spec)?;
        let mut covers = Self {
            spec: spec.clone(),
            assigner: Assigner::new(settings.assigner)?,
            members: Vec::new(),
            current: 0,
            rollout: RolloutBuffer::new(spec, steps)?,
            streams: Streams::new(settings.seed),
            seconds: Seconds::default(),
            settings,
        };
        covers.open_policy(None)?;
        Ok(covers)
    }

    /// One turn of Algorithm 1: roll out, assign, update. Episodes begin anew, so that every one shows its first frames.
    ///
    /// # Errors
    /// What the environment, the policy or the assigner says.
    pub fn learn<E: VectorEnv>(&mut self, env: &mut E) -> Result<Report, CoversError> {
        self.seconds = Seconds::default();
        let collector = self.current;
        let mut stats = self.roll_out(env)?;
        let mut decisions = stats.decisions;
        let mut frames = self.first_frames()?;
        let mut assignment = self.assign(&frames, Look::First)?;
        let mut first_look = None;
        // the paper opens a policy on a single rollout
        if assignment.decision == Decision::Undecided {
            stats = self.roll_out(env)?;
            decisions += stats.decisions;
            frames.extend(self.first_frames()?);
            first_look = Some(assignment.evidence);
            assignment = self.assign(&frames, Look::Second)?;
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
        Ok(Report {
            policy: self.current,
            created,
            evidence: assignment.evidence,
            first_look,
            decisions,
            rollout: stats,
            update,
            seconds: self.seconds,
        })
    }

    /// Collects `N_s` decisions with the current policy.
    fn roll_out<E: VectorEnv>(&mut self, env: &mut E) -> Result<RolloutStats, CoversError> {
        let clock = Instant::now();
        let mut state = RolloutState::reset(env)?;
        let policy = &mut self.members[self.current].policy;
        let (buffer, rng) = (&mut self.rollout, &mut self.streams.actions);
        let stats = collect(env, policy, buffer, &mut state, rng)?;
        self.seconds.collection += clock.elapsed().as_secs_f64();
        Ok(stats)
    }

    /// Improves the current policy by the rollout.
    fn update(&mut self) -> Result<UpdateStats, CoversError> {
        let clock = Instant::now();
        let Member { policy, ppo, .. } = &mut self.members[self.current];
        let stats = ppo.update(policy, &self.rollout, &mut self.streams.updates)?;
        self.seconds.update += clock.elapsed().as_secs_f64();
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
        let needed = self.settings.min_episodes();
        if got >= needed {
            return Ok(());
        }
        Err(CoversError::TooFewEpisodes {
            got,
            needed,
            first_frames: self.settings.first_frames,
        })
    }

    fn assign(&mut self, frames: &[FirstFrames], look: Look) -> Result<Assignment, CoversError> {
        let clock = Instant::now();
        let rng = &mut self.streams.assignment;
        let assignment = assign(&self.assigner, &mut self.members, frames, look, rng)?;
        self.seconds.assignment += clock.elapsed().as_secs_f64();
        Ok(assignment)
    }

    /// Makes the assigned policy current and gives it the frames; returns whether it was created for them.
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
        let member = &mut self.members[self.current];
        if self.settings.embedding == Embedding::AtArrival {
            keep_features(&mut member.policy, &mut frames)?;
        }
        for episode in frames {
            member.buffer.offer(episode, &mut self.streams.assignment);
        }
        Ok(self.current == policies)
    }

    /// Adds a policy with an empty buffer, random or with the parameters of `parent`; returns its index.
    fn open_policy(&mut self, parent: Option<usize>) -> Result<usize, CoversError> {
        let policy = match parent {
            Some(parent) => self.members[parent].policy.clone(),
            None => {
                let seed = self.streams.initialisation.random();
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

    /// Finds the policy for what `env` runs, from the first frames of as many episodes as the assigner needs, at least one in
    /// each environment; learns nothing.
    ///
    /// Where the assigner accepts none, the nearest one answers. All draws come from `rng`, so that looking
    /// does not change what is learnt next.
    ///
    /// # Errors
    /// What the environment, the policy or the assigner says.
    pub fn recognise<E: VectorEnv>(
        &mut self,
        env: &mut E,
        rng: &mut ChaCha8Rng,
    ) -> Result<usize, CoversError> {
        let k = self.settings.first_frames;
        let mut glimpse = RolloutBuffer::new(env.spec(), k)?;
        let mut frames = Vec::new();
        while frames.len() < self.settings.min_episodes() {
            let mut state = RolloutState::reset(env)?;
            let policy = &mut self.members[self.current].policy;
            collect(env, policy, &mut glimpse, &mut state, rng)?;
            let seen = first_frames(&glimpse, k);
            if seen.is_empty() {
                return self.check_episodes(0).map(|()| self.current);
            }
            frames.extend(seen);
        }
        let members = &mut self.members;
        let assignment = assign(&self.assigner, members, &frames, Look::First, rng)?;
        Ok(match assignment.decision {
            Decision::Existing(index) => index,
            Decision::New | Decision::Undecided => assignment.nearest().unwrap_or(0),
        })
    }

    /// Runs `rounds` episodes in every environment with the mean actions of policy `index`; learns nothing.
    ///
    /// # Errors
    /// [`CoversError::Setting`] for a policy that does not exist, or what the environment says.
    pub fn perform<E: VectorEnv>(
        &mut self,
        index: usize,
        env: &mut E,
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

    /// Episodes whose first frames policy `index` keeps, the size of its `B`; `None` for a policy that does not exist.
    pub fn buffered_episodes(&self, index: usize) -> Option<usize> {
        let member = self.members.get(index)?;
        Some(member.buffer.episodes().len())
    }

    /// The number of policies created so far.
    pub fn policies(&self) -> usize {
        self.members.len()
    }
}

/// Compares the rollout's first frames `O` with every policy's `B`, in that policy's own features.
///
/// The paper starts with an empty `B`, for which no distance exists: the first `O` seeds the first policy.
fn assign(
    assigner: &Assigner,
    members: &mut [Member],
    rollout: &[FirstFrames],
    look: Look,
    rng: &mut ChaCha8Rng,
) -> Result<Assignment, CoversError> {
    if let [only] = members
        && only.buffer.episodes().is_empty()
    {
        return Ok(Assignment {
            decision: Decision::Existing(0),
            evidence: Vec::new(),
        });
    }
    let candidates = members
        .iter_mut()
        .map(|Member { policy, buffer, .. }| {
            Ok(Candidate {
                buffer: recall(policy, buffer.episodes())?,
                rollout: embed(policy, rollout)?,
            })
        })
        .collect::<Result<Vec<_>, CoversError>>()?;
    Ok(match look {
        Look::First => assigner.assign(&candidates, rng)?,
        Look::Second => assigner.settle(&candidates, rng)?,
    })
}
