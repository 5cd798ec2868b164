//! How active the units of a network are.

use crate::env::Observations;
use crate::error::RlError;
use crate::policy::Actor;

/// What the rectified units of a network put out on average: Sokar et al., "The dormant neuron
/// phenomenon in deep reinforcement learning" (ICML 2023, section 3).
///
/// A unit is a channel of a ReLU in the basis in which it is pointwise, so a regular field of D2 has
/// four; one of a convolution is averaged over places, too. What is not rectified, such as the state
/// of a GRU, is no unit here.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Activity {
    /// Sums of what each unit put out, a list for each ReLU.
    layers: Vec<Vec<f64>>,
}

/// A policy whose network has units.
pub trait Units: Actor {
    /// What the units of all parts of the network put out for the observations of N environments,
    /// of which `memory` holds what is remembered. Critics see the mean actions.
    ///
    /// # Errors
    /// [`RlError::Shape`] when an array does not fit.
    fn activity(
        &self,
        observations: &Observations,
        memory: &Self::Memory,
    ) -> Result<Activity, RlError>;
}

impl Activity {
    /// The activity of layers whose units put out these sums, each over equally many samples.
    pub(crate) fn of(layers: Vec<Vec<f64>>) -> Self {
        Self { layers }
    }

    /// Adds what the same units put out for other observations.
    pub fn add(&mut self, other: &Self) {
        if self.layers.is_empty() {
            self.clone_from(other);
            return;
        }
        for (own, other) in self.layers.iter_mut().zip(&other.layers) {
            own.iter_mut().zip(other).for_each(|(sum, x)| *sum += x);
        }
    }

    /// The number of units; 0 where nothing was seen.
    pub fn units(&self) -> usize {
        self.layers.iter().map(Vec::len).sum()
    }

    /// The number of units that are `tau`-dormant: those that put out at most `tau` times the mean
    /// of their layer (Sokar et al., definition 3.1). All of a layer that puts out nothing are.
    pub fn dormant(&self, tau: f64) -> usize {
        let dormant = |sums: &Vec<f64>| {
            let mean = sums.iter().sum::<f64>() / sums.len() as f64;
            sums.iter().filter(|&&sum| sum <= tau * mean).count()
        };
        self.layers.iter().map(dormant).sum()
    }
}

#[cfg(test)]
mod tests {
    use std::ops::Range;

    use equivariant::{Layer, Sequential, Signature};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use symmetry::Group;

    use super::*;
    use crate::actor_critic_policy::ActorCriticPolicy;
    use crate::fixtures::{settings, spec, strided};
    use crate::policy::Memory;
    use crate::sac::policy::SacPolicy;
    use crate::sac::settings::ContextSettings;

    #[test]
    fn dormant_units_are_those_below_a_share_of_their_layers_mean() {
        let layers = vec![vec![0.0, 0.2, 3.8], vec![1.0; 4], vec![0.0; 2]];
        let mut activity = Activity::of(layers.clone());
        assert_eq!(activity.units(), 9);
        // the means are 4 / 3, 1 and 0
        assert_eq!([0.0, 0.1, 0.16, 1.0].map(|tau| activity.dormant(tau)), [3, 3, 4, 8]);
        let mut sum = Activity::default();
        assert_eq!((sum.units(), sum.dormant(0.5)), (0, 0));
        sum.add(&activity);
        assert_eq!(sum, activity);
        // what sleeps for some observations may be awake for others
        activity.add(&Activity::of(vec![vec![4.0, 0.0, 0.0], vec![1.0; 4], vec![0.0, 1.0]]));
        assert_eq!(activity.dormant(0.0), 1);
    }

    const TAU: f64 = 0.025;
    const SAMPLES: usize = 12;

    fn observations() -> Observations {
        let (spec, mut rng) = (spec(), ChaCha8Rng::seed_from_u64(5));
        let mut out = Observations {
            images: vec![0; SAMPLES * spec.image_len()],
            vectors: vec![0.0; SAMPLES * spec.vector.len()],
        };
        out.images.fill_with(|| rng.random());
        out.vectors.fill_with(|| rng.random_range(-1.0..1.0));
        out
    }

    /// Sets the bias of a field of the first layer of `head`, whose parameters these are; without
    /// its weights it puts out the same for every input.
    fn set(head: &Sequential<f32>, params: &mut [f32], field: usize, bias: f32, weights: bool) {
        let first = &head.layers()[0];
        let (from, to) = (first.in_shape().fields, first.out_shape().fields);
        let fields = to.regular_fields().unwrap();
        let mut start = 0;
        for irrep in to.group().irreps() {
            let width = from.multiplicity(*irrep);
            if !weights {
                params[start + field * width..start + (field + 1) * width].fill(0.0);
            }
            start += fields * width;
        }
        params[start + field] = bias;
    }

    /// All units of a hidden layer are woken by large biases, then fields are killed by hand.
    fn kills(
        head: &Sequential<f32>,
        mut params: Vec<f32>,
        own: Range<usize>,
        activity: impl Fn(&[f32]) -> Activity,
    ) {
        let hidden = head.layers()[0].out_shape().fields;
        let fields = hidden.regular_fields().unwrap();
        for field in 0..fields {
            set(head, &mut params[own.clone()], field, 100.0, true);
        }
        let awake = activity(&params);
        for killed in 1..=fields {
            set(head, &mut params[own.clone()], killed - 1, -1.0, false);
            let found = activity(&params);
            assert_eq!(found.units(), awake.units());
            let expected = awake.dormant(TAU) + killed * hidden.group().order();
            assert_eq!(found.dormant(TAU), expected, "{head}");
        }
    }

    #[test]
    fn units_that_are_killed_by_hand_are_dormant() {
        let observations = observations();
        for group in Group::ALL {
            let settings = settings(group, strided());
            let policy = ActorCriticPolicy::new(&settings, &spec(), 1).unwrap();
            let (network, params) = (policy.network(), policy.params());
            let activity = |params: &[f32]| {
                let mut policy = policy.clone();
                policy.params_mut().copy_from_slice(params);
                policy.activity(&observations, &()).unwrap()
            };
            // the encoder has 2 and 3 fields, then come those of the vector and of both heads
            let fields = 2 + 3 + 2 + 2 + 3;
            assert_eq!(activity(params).units(), 4 * fields);
            let parts = network.parts();
            kills(&network.actor, params.to_vec(), parts.actor, activity);
            kills(&network.critic, params.to_vec(), parts.critic, activity);
        }
    }

    #[test]
    fn units_of_actors_with_a_context_and_of_their_critics_count() {
        let observations = observations();
        let context = ContextSettings { size: 4, length: 3 };
        for (group, context) in [(Group::D2, None), (Group::C1, Some(context))] {
            let settings = settings(group, strided());
            let policy = SacPolicy::new(&settings, context, &spec(), 1).unwrap();
            let (network, params) = (policy.network(), policy.params());
            let mut memory = policy.memory(SAMPLES);
            let mut actions = vec![0.0; SAMPLES * spec().action.len()];
            let mut acting = policy.clone();
            acting
                .mean_actions(&observations, &mut memory, &mut actions)
                .unwrap();
            (0..SAMPLES).for_each(|env| memory.remember(env, &[0.5; 3], 1.0));
            let activity = |params: &[f32]| {
                let mut policy = policy.clone();
                policy.params_mut().copy_from_slice(params);
                policy.activity(&observations, &memory).unwrap()
            };
            assert_eq!(activity(params).units(), 4 * (2 + 3 + 2 + 2 + 2 * 3));
            let parts = network.parts();
            kills(&network.actor, params.to_vec(), parts.actor, activity);
            for twin in parts.critics.twins {
                kills(&network.critic, params.to_vec(), twin, activity);
            }
            // what is remembered is read
            let forgotten = policy.activity(&observations, &policy.memory(SAMPLES));
            assert_eq!(forgotten.unwrap() == activity(params), context.is_none());
        }
    }
}
