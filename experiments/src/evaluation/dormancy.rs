//! Units of networks that are good for nothing any more.

use std::collections::BTreeMap;

use rl::Activity;
use serde::Serialize;

/// What a unit puts out at most, as a share of the mean of its layer, to be called dormant: the
/// value that Sokar et al. use for their figures ("The dormant neuron phenomenon in deep
/// reinforcement learning", ICML 2023, section 3).
pub const TAU: f64 = 0.025;

/// Dormant units of one policy's network, over the pictures on which an evaluation scored it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Dormancy {
    /// Index of the policy.
    pub policy: usize,
    /// Rectified units of the network.
    pub units: usize,
    /// Those that are dormant: they put out at most [`TAU`] times the mean of their layer.
    pub dormant: usize,
}

/// What the units of policies put out, by the policies' indices.
#[derive(Clone, Debug, Default)]
pub(super) struct Activities(BTreeMap<usize, Activity>);

impl Activities {
    /// Adds what the units of a policy put out in one variant.
    pub fn add(&mut self, policy: usize, activity: &Activity) {
        self.0.entry(policy).or_default().add(activity);
    }

    /// The dormant units of each policy; a network without units has no row.
    pub fn dormancies(&self) -> Vec<Dormancy> {
        let seen = self.0.iter().filter(|(_, activity)| activity.units() > 0);
        let dormancy = |(&policy, activity): (&usize, &Activity)| Dormancy {
            policy,
            units: activity.units(),
            dormant: activity.dormant(TAU),
        };
        seen.map(dormancy).collect()
    }
}
