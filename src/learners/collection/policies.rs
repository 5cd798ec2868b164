//! The collection of policies: what a learner is between two turns.

use cluster::Reservoir;
use rand::RngExt;
use rl::{Answers, EnvSpec, Observations, Plain, PlainPolicy};

use crate::error::CoversError;
use crate::groupings::Grouping;
use crate::learners::learner::Seconds;

use super::member::{Generators, Member};
use super::settings::{CollectionSettings, RolloutOf, buffer_capacity, steps_per_env};

/// What [`Learner::export`](crate::Learner::export) returns.
pub(super) type Exported = Result<(PlainPolicy, Answers), CoversError>;

/// The learner: a growing collection of policies. It has no place for a task label.
pub struct Collection<S: CollectionSettings> {
    pub(super) settings: S,
    pub(super) spec: EnvSpec,
    pub(super) grouping: Box<dyn Grouping>,
    pub(super) members: Vec<Member<S>>,
    pub(super) current: usize,
    pub(super) rollout: RolloutOf<S>,
    pub(super) generators: Generators,
    pub(super) seconds: Seconds,
}

impl<S: CollectionSettings> Collection<S> {
    /// A learner with one random policy and no frames, and the grouping that the settings name.
    ///
    /// # Errors
    /// A setting out of range, a grouping that needs labels, or an image size that the network
    /// cannot keep exactly symmetric.
    pub fn new(settings: S, spec: &EnvSpec) -> Result<Self, CoversError> {
        let grouping = settings.grouping().build()?;
        Self::with_grouping(settings, spec, grouping)
    }

    /// The same with a grouping of the caller's.
    ///
    /// # Errors
    /// A setting out of range, or an image size that the network cannot keep exactly symmetric.
    pub fn with_grouping(
        settings: S,
        spec: &EnvSpec,
        grouping: Box<dyn Grouping>,
    ) -> Result<Self, CoversError> {
        let steps = steps_per_env(&settings, spec, grouping.min_episodes())?;
        let mut collection = Self {
            spec: spec.clone(),
            grouping,
            members: Vec::new(),
            current: 0,
            rollout: settings.rollout(spec, steps)?,
            generators: Generators::new(settings.seed()),
            seconds: Seconds::default(),
            settings,
        };
        collection.open_policy(None)?;
        Ok(collection)
    }

    /// Adds a policy with an empty buffer, random or with the parameters of `parent`; returns its
    /// index.
    pub(super) fn open_policy(&mut self, parent: Option<usize>) -> Result<usize, CoversError> {
        let policy = match parent {
            Some(parent) => self.members[parent].policy.clone(),
            None => {
                let seed = self.generators.initialisation.random();
                self.settings.policy(&self.spec, seed)?
            }
        };
        let training = self.settings.training(&self.spec, &policy)?;
        let buffer = Reservoir::new(buffer_capacity(&self.settings))?;
        self.members.push(Member {
            policy,
            training,
            buffer,
        });
        Ok(self.members.len() - 1)
    }

    /// A policy in ordinary layers, and what it says of `observations`.
    pub(super) fn plain(&mut self, index: usize, observations: &Observations) -> Exported {
        let index = self.check_policy(index)?;
        let policy = &mut self.members[index].policy;
        Ok((policy.plain()?, policy.answers(observations)?))
    }

    /// Episodes whose first frames policy `index` keeps, the size of its `B`; `None` for a policy
    /// that does not exist.
    pub fn buffered_episodes(&self, index: usize) -> Option<usize> {
        let member = self.members.get(index)?;
        Some(member.buffer.episodes().len())
    }
}
