//! The collection of policies: what a learner is between two turns.

use cluster::Reservoir;
use rand::RngExt;
use rl::EnvSpec;

use crate::error::CoversError;
use crate::groupings::Grouping;
use crate::learners::learner::Seconds;

use super::member::{Generators, Member};
use super::settings::{CollectionSettings, Shared};
use super::training::Training;

/// The learner: a growing collection of policies. It has no place for a task label.
pub struct Collection<T: Training> {
    pub(super) settings: T::Settings,
    /// Of the settings, what does not depend on the training.
    pub(super) shared: Shared,
    pub(super) spec: EnvSpec,
    pub(super) grouping: Box<dyn Grouping>,
    pub(super) members: Vec<Member<T>>,
    pub(super) current: usize,
    pub(super) rollout: T::Rollout,
    pub(super) generators: Generators,
    pub(super) seconds: Seconds,
}

impl<T: Training> Collection<T> {
    /// A learner with one random policy and no frames, and the grouping that the settings name.
    ///
    /// # Errors
    /// A setting out of range, a grouping that needs labels, or an image size that the network
    /// cannot keep exactly symmetric.
    pub fn new(settings: T::Settings, spec: &EnvSpec) -> Result<Self, CoversError> {
        let grouping = settings.shared().grouping.build()?;
        Self::with_grouping(settings, spec, grouping)
    }

    /// The same with a grouping of the caller's.
    ///
    /// # Errors
    /// A setting out of range, or an image size that the network cannot keep exactly symmetric.
    pub fn with_grouping(
        settings: T::Settings,
        spec: &EnvSpec,
        grouping: Box<dyn Grouping>,
    ) -> Result<Self, CoversError> {
        let shared = settings.shared();
        let steps = shared.steps_per_env(spec, grouping.min_episodes())?;
        let mut collection = Self {
            spec: spec.clone(),
            grouping,
            members: Vec::new(),
            current: 0,
            rollout: T::rollout(spec, steps)?,
            generators: Generators::new(shared.seed),
            seconds: Seconds::default(),
            settings,
            shared,
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
                T::policy(&self.settings, &self.spec, seed)?
            }
        };
        let training = T::new(&self.settings, &self.spec, &policy)?;
        let buffer = Reservoir::new(self.shared.buffer_capacity())?;
        self.members.push(Member {
            policy,
            training,
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
