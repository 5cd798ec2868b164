//! A collection of policies, one for each group of symmetric tasks: the part that COVERS and its
//! variants share, whatever trains the policies.

mod algorithm;
mod checkpoint;
mod episodes;
mod extensions;
mod settings;

pub use checkpoint::read_checkpoint_note;
pub use episodes::{Rollout, SingleEnvStep};
pub use settings::{
    CommonSettings, NewPolicyInit, PolicyCollectionSettings, PolicyTrainer,
    ReassignedRolloutHandling,
};

use cluster::{NearerPolicyInputs, Reservoir, RolloutAndBufferFeatures};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{EnvSpec, RlError, RolloutStats, VectorEnv};
use serde::{Deserialize, Serialize};
use web_time::Instant;

use crate::error::LearnerError;
use crate::groupings::{AssignmentData, Grouping, GroupingSettings, RolloutEpisodes};

use super::learner::IterationReport;
use episodes::{FirstFrames, ObservedEpisodes, embed_first_frames};
use settings::{PolicyInCollection, RolloutInCollection, RolloutStateInCollection};

/// Returns the error of a new policy that should copy the nearest one where no distances are
/// measured.
fn no_nearest_policy() -> LearnerError {
    let expected = "random with a grouping that measures no distances: none is nearest";
    LearnerError::invalid("new_policy", "copy", expected)
}

/// Learner with a growing collection of policies. It never receives a task label.
pub struct PolicyCollection<S: PolicyCollectionSettings> {
    settings: S,
    spec: EnvSpec,
    grouping: Box<dyn Grouping>,
    /// The paper's collection of pairs of a policy and its buffer `B` of first frames.
    policies: Vec<PolicyEntry<S>>,
    /// Index of the policy that acts.
    current: usize,
    /// Rollout that is being assigned: the paper's online rollout buffer `D`.
    rollout: RolloutInCollection<S>,
    generators: Generators,
}

/// Policy with its training, and the first frames of the task group that it serves.
struct PolicyEntry<S: PolicyCollectionSettings> {
    policy: PolicyInCollection<S>,
    training: S::Trainer,
    /// Policy from before its latest update; `None` if it was never updated.
    previous: Option<PolicyInCollection<S>>,
    buffer: Reservoir<FirstFrames>,
}

impl<S: PolicyCollectionSettings> PolicyCollection<S> {
    /// Creates a learner with one randomly initialised policy, which keeps no frames yet, and the
    /// grouping that the settings name.
    ///
    /// # Errors
    /// A setting out of range, a grouping that needs labels, or an image size that the network
    /// cannot keep exactly symmetric.
    pub fn new(settings: S, spec: &EnvSpec) -> Result<Self, LearnerError> {
        let grouping = settings.common().grouping.build_grouping()?;
        Self::with_grouping(settings, spec, grouping)
    }

    /// Creates a learner with one randomly initialised policy, which keeps no frames yet, and the
    /// caller's grouping in place of that of the settings.
    ///
    /// # Errors
    /// A setting out of range, or an image size that the network cannot keep exactly symmetric.
    pub fn with_grouping(
        settings: S,
        spec: &EnvSpec,
        grouping: Box<dyn Grouping>,
    ) -> Result<Self, LearnerError> {
        let common = settings.common();
        // labels measure no distances, so the run would end at its second group; a single policy
        // stays the only one
        let has_distances =
            !matches!(common.grouping, GroupingSettings::Oracle | GroupingSettings::Single);
        if common.new_policy == NewPolicyInit::Copy && !has_distances {
            return Err(no_nearest_policy());
        }
        let steps = common.steps_per_env(spec, grouping.requirements().episodes)?;
        let mut collection = Self {
            spec: spec.clone(),
            grouping,
            policies: Vec::new(),
            current: 0,
            rollout: settings.new_rollout(spec, steps)?,
            generators: Generators::new(common.seed),
            settings,
        };
        // policy 0 takes the first rollout, for which there is nothing to compare
        collection.create_policy(None)?;
        Ok(collection)
    }

    /// Adds a policy with an empty buffer, random or with the parameters of `parent`; returns its
    /// index.
    fn create_policy(&mut self, parent: Option<usize>) -> Result<usize, LearnerError> {
        let policy = match parent {
            Some(parent) => self.policies[parent].policy.clone(),
            None => {
                let seed = self.generators.initialisation.random();
                self.settings.new_policy(&self.spec, seed)?
            }
        };
        let training = self.settings.new_training(&self.spec, &policy)?;
        let buffer = Reservoir::new(self.settings.common().buffer_capacity())?;
        self.policies.push(PolicyEntry { policy, training, previous: None, buffer });
        Ok(self.policies.len() - 1)
    }

    /// Checks that a policy exists.
    fn check_policy(&self, index: usize) -> Result<usize, LearnerError> {
        if index < self.policies.len() {
            return Ok(index);
        }
        let value = format!("{index} (policies so far: {}, from 0)", self.policies.len());
        Err(LearnerError::invalid("policy", value, "the index of a policy that was created"))
    }

    /// Returns the number of episodes whose first frames policy `index` keeps, the size of the
    /// paper's buffer `B`; `None` for a policy that does not exist.
    pub fn num_policy_buffer_episodes(&self, index: usize) -> Option<usize> {
        let entry = self.policies.get(index)?;
        Some(entry.buffer.episodes().len())
    }
}

impl<S: PolicyCollectionSettings> PolicyEntry<S> {
    /// Swaps the policy with that from before its latest update, if it was updated.
    fn swap_previous(&mut self) {
        if let Some(previous) = &mut self.previous {
            std::mem::swap(&mut self.policy, previous);
        }
    }

    /// Fills `rollout` with the episodes of this policy that begin in `state`, and counts them in
    /// `iteration`.
    fn act(
        &mut self,
        env: &mut dyn VectorEnv,
        mut state: RolloutStateInCollection<S>,
        rollout: &mut RolloutInCollection<S>,
        rng: &mut ChaCha8Rng,
        iteration: &mut IterationReport,
    ) -> Result<RolloutStats, RlError> {
        let clock = Instant::now();
        self.training.prepare_rollout(rollout);
        let stats = rl::collect_experience(env, &mut self.policy, rollout, &mut state, rng)?;
        iteration.decisions += stats.decisions;
        iteration.seconds.collection += clock.elapsed().as_secs_f64();
        Ok(stats)
    }
}

/// Policies with the first frames that they keep, and the rollout that is to be assigned to one of
/// them.
struct CandidateClouds<'a, S: PolicyCollectionSettings> {
    policies: &'a mut [PolicyEntry<S>],
    frames: &'a [FirstFrames],
    episodes: RolloutEpisodes<'a>,
}

impl<'a, S: PolicyCollectionSettings> CandidateClouds<'a, S> {
    fn new(
        policies: &'a mut [PolicyEntry<S>],
        collector: usize,
        spec: &'a EnvSpec,
        observed: &'a ObservedEpisodes,
    ) -> Self {
        Self {
            policies,
            frames: &observed.frames,
            episodes: RolloutEpisodes { spec, collector, trajectories: &observed.trajectories },
        }
    }
}

impl<S: PolicyCollectionSettings> AssignmentData for CandidateClouds<'_, S> {
    fn clouds(&mut self) -> Result<Vec<RolloutAndBufferFeatures>, LearnerError> {
        let clouds = self.policies.iter_mut().map(|entry| {
            Ok(RolloutAndBufferFeatures {
                buffer: embed_first_frames(&mut entry.policy, entry.buffer.episodes())?,
                rollout: embed_first_frames(&mut entry.policy, self.frames)?,
            })
        });
        clouds.collect()
    }

    fn comparisons(
        &mut self,
        indices: [usize; 2],
        most: usize,
    ) -> Result<[NearerPolicyInputs; 2], LearnerError> {
        let (mut policies, buffers): (Vec<_>, Vec<_>) = self
            .policies
            .iter_mut()
            .map(|entry| {
                let kept = entry.buffer.episodes();
                (&mut entry.policy, &kept[..kept.len().min(most)])
            })
            .unzip();
        let mut compare = |index: usize| -> Result<NearerPolicyInputs, LearnerError> {
            let policy = &mut *policies[index];
            let [first, second] = indices.map(|other| embed_first_frames(policy, buffers[other]));
            Ok(NearerPolicyInputs {
                rollout: embed_first_frames(policy, self.frames)?,
                policies: [first?, second?],
            })
        };
        // features of both policies, since those of the wrong one may distort distances
        let [first, second] = indices.map(&mut compare);
        Ok([first?, second?])
    }

    fn episodes(&self) -> RolloutEpisodes<'_> {
        self.episodes
    }
}

/// Random generators of the learner; each purpose has its own, so that none shifts another.
#[derive(Clone, Serialize, Deserialize)]
struct Generators {
    actions: ChaCha8Rng,
    updates: ChaCha8Rng,
    assignment: ChaCha8Rng,
    initialisation: ChaCha8Rng,
}

impl Generators {
    fn new(seed: u64) -> Self {
        // streams of one seed are independent; their numbers are part of the reproducible results
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
