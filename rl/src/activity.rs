//! Activations of a network's units, from which dormant units are counted.

use crate::env::Observations;
use crate::error::RlError;
use crate::policy::Actor;

/// Summed activations of a network's ReLU units: Sokar et al., "The dormant neuron phenomenon in
/// deep reinforcement learning" (ICML 2023, section 3).
///
/// A unit is a channel of a ReLU in the basis in which it is pointwise, so a regular field of D2
/// has four; units of a convolution are also averaged over positions. Outputs without a ReLU, such
/// as the state of a GRU, do not count as units.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UnitActivity {
    /// Sum of each ReLU unit's outputs over the samples, one list for each ReLU.
    layers: Vec<Vec<f64>>,
}

/// A policy whose network can report the activations of its units.
pub trait MeasureUnitActivity: Actor {
    /// Returns the summed activations of the ReLU units in all parts of the network, for the
    /// observations of N environments and their `memory`. Critics are evaluated at the mean
    /// actions.
    ///
    /// # Errors
    /// [`RlError::ShapeMismatch`] when an array does not fit.
    fn unit_activity(
        &self,
        observations: &Observations,
        memory: &Self::Memory,
    ) -> Result<UnitActivity, RlError>;
}

impl UnitActivity {
    /// Creates the activations from sums of each ReLU's outputs, all over equally many samples.
    pub(crate) fn from_layer_sums(layers: Vec<Vec<f64>>) -> Self {
        Self { layers }
    }

    /// Adds `other`, the summed activations of the same units for other observations.
    pub fn add(&mut self, other: &Self) {
        // the default has no layers yet
        if self.layers.is_empty() {
            self.clone_from(other);
            return;
        }
        for (own, theirs) in self.layers.iter_mut().zip(&other.layers) {
            own.iter_mut().zip(theirs).for_each(|(sum, x)| *sum += x);
        }
    }

    /// Returns the number of measured ReLU units; 0 before any activations were added.
    pub fn num_units(&self) -> usize {
        self.layers.iter().map(Vec::len).sum()
    }

    /// Returns the number of `tau`-dormant units, whose mean output is at most `tau` times the mean
    /// of their layer (Sokar et al., definition 3.1).
    pub fn num_dormant_units(&self, tau: f64) -> usize {
        let dormant = |sums: &Vec<f64>| {
            let mean = sums.iter().sum::<f64>() / sums.len() as f64;
            // `<=`, so that all units of a layer without any output count as dormant
            sums.iter().filter(|&&sum| sum <= tau * mean).count()
        };
        self.layers.iter().map(dormant).sum()
    }
}

#[cfg(test)]
mod tests {
    use symmetry::Group;

    use super::*;
    use crate::fixtures::{check_killed_units, observations, settings, spec, strided};
    use crate::network_policy::ActorCriticPolicy;

    #[test]
    fn dormant_units_are_those_below_a_share_of_their_layers_mean() {
        let layers = vec![vec![0.0, 0.2, 3.8], vec![1.0; 4], vec![0.0; 2]];
        let mut activity = UnitActivity::from_layer_sums(layers.clone());
        assert_eq!(activity.num_units(), 9);
        // the means are 4 / 3, 1 and 0
        assert_eq!([0.0, 0.1, 0.16, 1.0].map(|tau| activity.num_dormant_units(tau)), [3, 3, 4, 8]);
        let mut sum = UnitActivity::default();
        assert_eq!((sum.num_units(), sum.num_dormant_units(0.5)), (0, 0));
        sum.add(&activity);
        assert_eq!(sum, activity);
        // a unit that is dormant for some observations may be active for others
        activity.add(&UnitActivity::from_layer_sums(vec![
            vec![4.0, 0.0, 0.0],
            vec![1.0; 4],
            vec![0.0, 1.0],
        ]));
        assert_eq!(activity.num_dormant_units(0.0), 1);
    }

    #[test]
    fn units_that_are_killed_by_hand_are_dormant() {
        let observations = observations(12);
        for group in Group::ALL {
            let settings = settings(group, strided());
            let policy = ActorCriticPolicy::new(&settings, &spec(), 1).unwrap();
            let (network, params) = (policy.network(), policy.params());
            let activity = |given: &[f32]| {
                let mut policy = policy.clone();
                policy.params_mut().copy_from_slice(given);
                policy.unit_activity(&observations, &()).unwrap()
            };
            // the encoder has 2 and 3 fields, then come those of the vector and of both heads
            let fields = 2 + 3 + 2 + 2 + 3;
            assert_eq!(activity(params).num_units(), 4 * fields);
            let ranges = network.param_ranges();
            check_killed_units(&network.actor, params.to_vec(), ranges.actor, activity);
            check_killed_units(&network.critic, params.to_vec(), ranges.critic, activity);
        }
    }
}
