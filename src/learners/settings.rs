//! The registry of learners: settings that name one.

use std::path::Path;

use rl::EnvSpec;
use serde::{Deserialize, Serialize};
use symmetry::Group;

use crate::error::CoversError;
use crate::groupings::{GroupingSettings, Labels};

use super::covers::{Covers, CoversSettings};
use super::learner::Learner;

/// A learner from a file, and the file's note.
type Loaded = Result<(Box<dyn Learner>, String), CoversError>;

/// What learns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum LearnerSettings {
    /// A collection of policies trained by PPO: COVERS and the paper's PPO baselines.
    Covers(CoversSettings),
}

impl Default for LearnerSettings {
    fn default() -> Self {
        Self::Covers(CoversSettings::default())
    }
}

impl LearnerSettings {
    /// A fresh learner. A grouping that needs labels reads `labels`, which only a run writes.
    ///
    /// # Errors
    /// A setting out of range, or images that the network cannot take.
    pub fn start(&self, spec: &EnvSpec, labels: &Labels) -> Result<Box<dyn Learner>, CoversError> {
        match self {
            Self::Covers(settings) => {
                let grouping = settings.grouping.build_with(labels)?;
                let covers = Covers::with_grouping(settings.clone(), spec, grouping)?;
                Ok(Box::new(covers))
            }
        }
    }

    /// Reads what [`Learner::save`] wrote, for acting and recognising; returns the note, too.
    ///
    /// # Errors
    /// [`CoversError::Read`] for a file that is missing, damaged, of a learner of other settings, or
    /// of other environments.
    pub fn load(&self, path: &Path, spec: &EnvSpec, labels: &Labels) -> Loaded {
        self.read(path, spec, labels, false)
    }

    /// As [`LearnerSettings::load`], for a copy that learns on to the same bits.
    ///
    /// # Errors
    /// As there, and [`CoversError::PoliciesOnly`] for a file of
    /// [`Extent::Policies`](super::Extent::Policies).
    pub fn resume(&self, path: &Path, spec: &EnvSpec, labels: &Labels) -> Loaded {
        self.read(path, spec, labels, true)
    }

    fn read(&self, path: &Path, spec: &EnvSpec, labels: &Labels, whole: bool) -> Loaded {
        let Self::Covers(settings) = self;
        let (covers, note) = Covers::read(path, spec, settings, labels, whole)?;
        Ok((Box::new(covers), note))
    }

    /// Seed of everything that the learner draws.
    pub fn seed(&self) -> u64 {
        let Self::Covers(settings) = self;
        settings.seed
    }

    /// Changes the seed.
    pub fn set_seed(&mut self, seed: u64) {
        let Self::Covers(settings) = self;
        settings.seed = seed;
    }

    /// Changes the group that networks are equivariant under, at equal width.
    pub fn set_group(&mut self, group: Group) {
        let Self::Covers(settings) = self;
        settings.network.group = group;
    }

    /// Whether it may keep more than one policy.
    pub fn tells_groups_apart(&self) -> bool {
        let Self::Covers(settings) = self;
        settings.grouping != GroupingSettings::Single
    }

    /// Decisions of one rollout, all environments together.
    pub fn rollout_steps(&self) -> usize {
        let Self::Covers(settings) = self;
        settings.rollout_steps
    }
}
