//! Registry of learners: settings of every kind of learner.

use std::path::Path;

use rl::{EnvSpec, ProcessRanks};
use serde::{Deserialize, Serialize};
use symmetry::Group;

use crate::error::LearnerError;
use crate::groupings::{GroupingSettings, TaskLabel};

use super::collection::{CommonSettings, PolicyCollection, PolicyCollectionSettings};
use super::covers::CoversSettings;
use super::device::{DeviceChoice, LearningDevice};
use super::learner::Learner;
use super::off_policy::OffPolicySettings;

/// Learner read from a checkpoint, and the caller's note in it.
type Loaded = Result<(Box<dyn Learner>, String), LearnerError>;

/// Evaluates an expression with the settings of a learner of any kind.
macro_rules! each {
    ($learner:expr, $settings:ident => $result:expr) => {
        match $learner {
            LearnerSettings::Covers($settings) => $result,
            LearnerSettings::OffPolicy($settings) => $result,
        }
    };
}

/// Settings of a learner of one of two kinds: trained by PPO, or by soft actor-critic from replays.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum LearnerSettings {
    /// Collection of policies trained by PPO: COVERS and the paper's PPO baselines.
    Covers(CoversSettings),
    /// Policy, or a collection of them, trained by soft actor-critic from replay buffers: CLEAR,
    /// 3RL and equivariant policies.
    OffPolicy(OffPolicySettings),
}

impl Default for LearnerSettings {
    fn default() -> Self {
        Self::Covers(CoversSettings::default())
    }
}

impl LearnerSettings {
    /// Creates an untrained learner with these settings. A grouping that needs labels reads
    /// `labels`, which only a run writes.
    ///
    /// # Errors
    /// A setting out of range, or images that the network cannot take.
    pub fn new_learner(
        &self,
        spec: &EnvSpec,
        labels: &TaskLabel,
    ) -> Result<Box<dyn Learner>, LearnerError> {
        each!(self, settings => {
            let grouping = settings.grouping.build_with(labels)?;
            Ok(Box::new(PolicyCollection::with_grouping(settings.clone(), spec, grouping)?))
        })
    }

    /// Reads a learner and the caller's note from a checkpoint that [`Learner::save`] wrote, for
    /// acting and recognition without further training.
    ///
    /// # Errors
    /// [`LearnerError::Read`] for a file that is missing, damaged or of other environments;
    /// [`LearnerError::CheckpointSettingsDiffer`] and [`LearnerError::OtherMethod`] for a learner
    /// of other settings.
    pub fn load_for_acting(&self, path: &Path, spec: &EnvSpec, labels: &TaskLabel) -> Loaded {
        self.read(path, spec, labels, false)
    }

    /// Reads a learner and the caller's note from a checkpoint that [`Learner::save`] wrote, for
    /// further training that gives bit-identical results.
    ///
    /// # Errors
    /// Errors of [`LearnerSettings::load_for_acting`], and [`LearnerError::PoliciesOnlyCheckpoint`]
    /// for a file of [`CheckpointExtent::Policies`](super::CheckpointExtent::Policies).
    pub fn load_for_training(&self, path: &Path, spec: &EnvSpec, labels: &TaskLabel) -> Loaded {
        self.read(path, spec, labels, true)
    }

    fn read(&self, path: &Path, spec: &EnvSpec, labels: &TaskLabel, whole: bool) -> Loaded {
        each!(self, settings => {
            let (learner, note) =
                PolicyCollection::read_with_labels(path, spec, settings, labels, whole)?;
            Ok((Box::new(learner), note))
        })
    }

    /// Returns the settings that every collection of policies has.
    pub fn common(&self) -> CommonSettings {
        each!(self, settings => settings.common())
    }

    /// Returns the seed of all random numbers of the learner.
    pub fn seed(&self) -> u64 {
        self.common().seed
    }

    /// Changes the seed of all random numbers of the learner.
    pub fn set_seed(&mut self, seed: u64) {
        each!(self, settings => settings.seed = seed);
    }

    /// Changes the symmetry group that networks are equivariant under; their widths stay.
    pub fn set_symmetry_group(&mut self, group: Group) {
        each!(self, settings => settings.network.group = group);
    }

    /// Sets the device that policies train on, and opens it if it is a GPU. With
    /// [`DeviceChoice::Auto`], learners whose updates run on the CPU alone stay there.
    ///
    /// # Errors
    /// Errors of [`DeviceChoice::open`], and a GPU for learners whose updates run on the CPU
    /// alone: those with replays, and those with a symmetry loss.
    pub fn set_device(&mut self, choice: DeviceChoice) -> Result<(), LearnerError> {
        let expected = match self {
            Self::Covers(settings) if settings.ppo.symmetry.is_none() => {
                settings.device = choice.open()?;
                return Ok(());
            }
            Self::Covers(settings) => {
                settings.device = LearningDevice::Cpu;
                "`cpu` or `auto`: a symmetry loss (`covers.ppo.symmetry`) has no updates on a GPU"
            }
            Self::OffPolicy(_) => "`cpu` or `auto`: a learner with replays has no updates on a GPU",
        };
        match choice {
            DeviceChoice::Cpu | DeviceChoice::Auto => Ok(()),
            DeviceChoice::Gpu => Err(LearnerError::invalid("device", choice, expected)),
        }
    }

    /// Returns the name of the GPU that policies train on; `None` on the CPU.
    pub fn gpu_name(&self) -> Option<&str> {
        match self {
            Self::Covers(settings) => settings.device.gpu_name(),
            Self::OffPolicy(_) => None,
        }
    }

    /// Sets the processes that share the updates of policies on the CPU.
    ///
    /// # Errors
    /// [`LearnerError::InvalidSetting`] if policies train on a GPU.
    pub fn set_process_ranks(&mut self, ranks: ProcessRanks) -> Result<(), LearnerError> {
        if self.gpu_name().is_some() {
            let expected = "`cpu`: processes that train together share updates on the CPU";
            return Err(LearnerError::invalid("device", DeviceChoice::Gpu, expected));
        }
        each!(self, settings => settings.ranks = ranks);
        Ok(())
    }

    /// Returns the processes that share the updates of policies.
    pub fn process_ranks(&self) -> &ProcessRanks {
        each!(self, settings => &settings.ranks)
    }

    /// Replaces the grouping by that of `run` if that is the removed grouping `calibrated` of
    /// earlier versions and `self` has its successor.
    pub fn copy_removed_grouping_from(&mut self, run: &Self) {
        if let removed @ GroupingSettings::Removed(_) = run.grouping()
            && matches!(self.grouping(), GroupingSettings::Evidence(_))
        {
            each!(self, settings => settings.grouping = removed);
        }
    }

    /// Returns the rule that assigns rollouts to policies.
    pub fn grouping(&self) -> GroupingSettings {
        self.common().grouping
    }

    /// Returns `true` if the learner may keep more than one policy.
    pub fn may_hold_several_policies(&self) -> bool {
        self.grouping() != GroupingSettings::Single
    }

    /// Returns the reason why the learner has no task groups to recognise by itself: one policy for
    /// all, or given labels; `None` if it recognises them.
    pub fn recognition_obstacle(&self) -> Option<&'static str> {
        match self.grouping() {
            GroupingSettings::Single => Some("there is one policy for everything"),
            GroupingSettings::Oracle => Some("the learner is told the group"),
            _ => None,
        }
    }

    /// Returns the number of decisions of one rollout, all environments together.
    pub fn rollout_steps(&self) -> usize {
        self.common().rollout_steps
    }
}

#[cfg(test)]
mod tests {
    use serde::de::DeserializeOwned;

    use super::*;
    use crate::learners::NewPolicyInit;

    fn read<S: DeserializeOwned>(text: &str) -> serde_json::Result<S> {
        serde_json::from_str(text)
    }

    #[test]
    fn settings_survive_a_file() {
        let other = CoversSettings {
            new_policy: NewPolicyInit::Copy,
            seed: u64::MAX,
            ..CoversSettings::paper()
        };
        let off_policy = LearnerSettings::OffPolicy(OffPolicySettings::clear_baseline());
        for settings in [LearnerSettings::Covers(other), off_policy] {
            let text = serde_json::to_string(&settings).unwrap();
            assert_eq!(read::<LearnerSettings>(&text).unwrap(), settings);
        }
    }

    #[test]
    fn what_is_missing_has_its_default_and_what_does_not_exist_is_refused() {
        assert_eq!(read::<CoversSettings>("{}").unwrap(), CoversSettings::default());
        assert_eq!(read::<OffPolicySettings>("{}").unwrap(), OffPolicySettings::clear_baseline());
        assert!(read::<CoversSettings>(r#"{"hand_over": "reuse"}"#).is_err());
        assert!(read::<CoversSettings>(r#"{"handover": "keep"}"#).is_err());
        assert!(read::<OffPolicySettings>(r#"{"handover": "reuse"}"#).is_err());
    }
}
