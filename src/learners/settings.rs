//! The registry of learners: settings that name one.

use std::path::Path;

use rl::EnvSpec;
use serde::{Deserialize, Serialize};
use symmetry::Group;

use crate::error::CoversError;
use crate::groupings::{GroupingSettings, Labels};

use super::collection::{Collection, CollectionSettings, Shared, Training};
use super::covers::{CoversSettings, PpoTraining};
use super::learner::Learner;
use super::off_policy::{OffPolicySettings, SacTraining};

/// A learner from a file, and the file's note.
type Loaded = Result<(Box<dyn Learner>, String), CoversError>;

/// What learns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum LearnerSettings {
    /// A collection of policies trained by PPO: COVERS and the paper's PPO baselines.
    Covers(CoversSettings),
    /// A policy, or a collection of them, trained by soft actor-critic from replays: CLEAR, 3RL and
    /// what came after.
    OffPolicy(OffPolicySettings),
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
            Self::Covers(settings) => start::<PpoTraining>(settings, spec, labels),
            Self::OffPolicy(settings) => start::<SacTraining>(settings, spec, labels),
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
        let place = (path, spec, labels);
        match self {
            Self::Covers(settings) => read::<PpoTraining>(settings, place, whole),
            Self::OffPolicy(settings) => read::<SacTraining>(settings, place, whole),
        }
    }

    /// What every learner's settings say.
    fn shared(&self) -> Shared {
        match self {
            Self::Covers(settings) => settings.shared(),
            Self::OffPolicy(settings) => settings.shared(),
        }
    }

    /// Seed of everything that the learner draws.
    pub fn seed(&self) -> u64 {
        self.shared().seed
    }

    /// Changes the seed.
    pub fn set_seed(&mut self, seed: u64) {
        match self {
            Self::Covers(settings) => settings.seed = seed,
            Self::OffPolicy(settings) => settings.seed = seed,
        }
    }

    /// Changes the group that networks are equivariant under, at equal width.
    pub fn set_group(&mut self, group: Group) {
        match self {
            Self::Covers(settings) => settings.network.group = group,
            Self::OffPolicy(settings) => settings.network.group = group,
        }
    }

    /// Whether it may keep more than one policy.
    pub fn tells_groups_apart(&self) -> bool {
        self.shared().grouping != GroupingSettings::Single
    }

    /// Why it makes no sense to ask it which policy a group belongs to, where that makes none.
    pub(crate) fn cannot_be_asked(&self) -> Option<&'static str> {
        match self.shared().grouping {
            GroupingSettings::Single => Some("there is one policy for everything"),
            GroupingSettings::Oracle => Some("the learner is told the group"),
            _ => None,
        }
    }

    /// Decisions of one rollout, all environments together.
    pub fn rollout_steps(&self) -> usize {
        self.shared().rollout_steps
    }
}

fn start<T: Training>(
    settings: &T::Settings,
    spec: &EnvSpec,
    labels: &Labels,
) -> Result<Box<dyn Learner>, CoversError> {
    let grouping = settings.shared().grouping.build_with(labels)?;
    let learner = Collection::<T>::with_grouping(settings.clone(), spec, grouping)?;
    Ok(Box::new(learner))
}

fn read<T: Training>(
    settings: &T::Settings,
    (path, spec, labels): (&Path, &EnvSpec, &Labels),
    whole: bool,
) -> Loaded {
    let (learner, note) = Collection::<T>::read(path, spec, settings, labels, whole)?;
    Ok((Box::new(learner), note))
}
