//! Dormant units of policy networks.

use std::collections::BTreeMap;

use rl::UnitActivity;

use crate::schema::DormantUnitsRow;

/// Threshold of dormancy: a unit is dormant if its mean output is at most this share of its
/// layer's mean. Sokar et al. use this value for their figures ("The dormant neuron phenomenon in
/// deep reinforcement learning", ICML 2023, section 3).
pub const DORMANCY_THRESHOLD: f64 = 0.025;

/// Outputs of the network units of each policy during an evaluation, by the policies' indices.
#[derive(Clone, Debug, Default)]
pub(super) struct UnitActivities(BTreeMap<usize, UnitActivity>);

impl UnitActivities {
    /// Adds the outputs of a policy's network units in one task variant.
    pub fn add(&mut self, policy: usize, activity: &UnitActivity) {
        self.0.entry(policy).or_default().add(activity);
    }

    /// Returns the rows of `units.csv`, one for each policy, of an evaluation after `rollouts`
    /// rollouts and `decisions` decisions; networks without rectified units are left out.
    pub fn dormant_unit_rows(&self, rollouts: usize, decisions: usize) -> Vec<DormantUnitsRow> {
        self.0
            .iter()
            .filter(|(_, activity)| activity.num_units() > 0)
            .map(|(&policy, activity)| DormantUnitsRow {
                rollouts,
                decisions,
                policy,
                unit_count: activity.num_units(),
                dormant_count: activity.num_dormant_units(DORMANCY_THRESHOLD),
            })
            .collect()
    }
}
