//! Folders of policies that have learnt nothing.

use std::path::PathBuf;

use covers::presets::Method;
use covers::{CheckpointExtent, Experiment, RunFolder, SwitchableVecEnv, TaskLabel};

use super::runs::two_groups;
use super::scratch::Scratch;

/// Short episodes of two groups, four environments and no arm, whose variants mirror exactly.
pub fn small(method: Method) -> Experiment {
    let mut experiment = two_groups(method).with_threads(1);
    experiment.envs.num_envs = 4;
    experiment.envs.control.horizon = 50;
    experiment
}

impl Scratch {
    /// A folder as `covers pack` makes it.
    pub fn pack(&self, experiment: &Experiment) -> PathBuf {
        let (spec, labels) = (SwitchableVecEnv::env_spec(&experiment.envs), TaskLabel::default());
        let learner = experiment.learner.new_learner(&spec, &labels).unwrap();
        let folder = self.0.join("packed");
        let extent = CheckpointExtent::Policies { episodes_per_policy: 100 };
        RunFolder::create_with_learner(&folder, experiment, &*learner, extent).unwrap();
        folder
    }
}
