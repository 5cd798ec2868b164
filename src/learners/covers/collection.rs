//! The collection of policies: what a learner is between two turns.

use cluster::Reservoir;
use rand::RngExt;
use rl::{ActorCriticPolicy, EnvSpec, Ppo, RolloutBuffer};

use crate::error::CoversError;
use crate::groupings::Grouping;
use crate::learners::learner::Seconds;

use super::member::{Generators, Member};
use super::settings::CoversSettings;

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

    /// Adds a policy with an empty buffer, random or with the parameters of `parent`; returns its
    /// index.
    pub(super) fn open_policy(&mut self, parent: Option<usize>) -> Result<usize, CoversError> {
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
