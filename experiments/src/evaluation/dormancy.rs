//! Dormant units of policy networks.

use std::collections::BTreeMap;

use rl::UnitActivity;
use serde::Serialize;

/// Threshold of dormancy: a unit is dormant if its mean output is at most this share of its
/// layer's mean. Sokar et al. use this value for their figures ("The dormant neuron phenomenon in
/// deep reinforcement learning", ICML 2023, section 3).
pub const DORMANCY_THRESHOLD: f64 = 0.025;

/// Numbers of rectified units, and of dormant ones among them (mean output almost zero), of one
/// policy's network in an evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct DormantUnitCounts {
    /// Index of the policy whose network units are counted.
    pub policy: usize,
    /// Number of rectified units (ReLU) of the policy's network.
    #[serde(rename = "units")]
    pub unit_count: usize,
    /// Number of dormant units: those whose mean output is at most [`DORMANCY_THRESHOLD`] times the
    /// mean of their layer.
    #[serde(rename = "dormant")]
    pub dormant_count: usize,
}

/// Outputs of the network units of each policy during an evaluation, by the policies' indices.
#[derive(Clone, Debug, Default)]
pub(super) struct UnitActivities(BTreeMap<usize, UnitActivity>);

impl UnitActivities {
    /// Adds the outputs of a policy's network units in one task variant.
    pub fn add(&mut self, policy: usize, activity: &UnitActivity) {
        self.0.entry(policy).or_default().add(activity);
    }

    /// Returns the numbers of units and of dormant units of each policy; networks without rectified
    /// units are left out.
    pub fn dormant_unit_counts(&self) -> Vec<DormantUnitCounts> {
        self.0
            .iter()
            .filter(|(_, activity)| activity.num_units() > 0)
            .map(|(&policy, activity)| DormantUnitCounts {
                policy,
                unit_count: activity.num_units(),
                dormant_count: activity.num_dormant_units(DORMANCY_THRESHOLD),
            })
            .collect()
    }
}
