//! The paper's policy network: equivariant actor, invariant critic, shared equivariant features.

use std::ops::Range;

use equivariant::{FieldType, Layer, Scalar, Sequential, Signature};
use rand::Rng;
use symmetry::irrep_order;

use crate::env::EnvSpec;
use crate::error::RlError;
use crate::network_settings::{Critic, NetworkSettings};
use crate::trunk::{Layout, OnTrunk, Trunk, head};

/// The policy network of COVERS (Liu et al., CoRL 2023, section 4.1, "Policy network
/// architecture").
///
/// ```text
/// image  [H, W, C] -> Encoder -----------------------------------------------+
/// vector [D]       -> Linear, ReLU ------------------------------------------+-> h, regular fields
/// h -> Linear, ReLU, Linear -> mean action [A], of the action's type
/// h -> GroupMaxPool -> features [F], invariant
/// h, or the features in the paper -> Linear, ReLU, Linear -> value
/// log_std [A]: parameters of their own, the same for every state
/// ```
///
/// Pooling acts on the image's and on the vector's fields separately, as in the paper, so the
/// features see each input up to a symmetry of its own: how the vector lies relative to the image
/// reaches only the actor and a [`Critic::Joint`].
///
/// Every part is equivariant under [`NetworkSettings::group`]: D2 is the paper's network, and C1 an
/// ordinary one of the same width, whose pooling does nothing.
///
/// It owns no weights: the parameters are one flat slice, the image encoder's first
/// ([`ActorCritic::encoder`]), then the others ([`ActorCritic::heads`]), of which the last A are
/// log_std.
pub struct ActorCritic<T> {
    pub(crate) trunk: Trunk<T>,
    pub(crate) actor: Sequential<T>,
    pub(crate) critic: Sequential<T>,
    /// Natural index of every irrep-major component of the action.
    pub(crate) action_order: Vec<usize>,
}

/// Where the parameters of each part lie in the flat slice.
pub(crate) struct Parts {
    pub actor: Range<usize>,
    pub critic: Range<usize>,
    pub log_std: Range<usize>,
}

impl<T: Scalar> ActorCritic<T> {
    /// The network for the images, vectors and actions of `spec`; its number of environments does
    /// not matter.
    ///
    /// # Errors
    /// [`RlError::ImageSize`] or [`RlError::NotSquare`] for images that the convolutions cannot
    /// treat exactly, [`RlError::Setting`] and [`RlError::EmptySpec`] for sizes of zero.
    pub fn new(settings: &NetworkSettings, spec: &EnvSpec) -> Result<Self, RlError> {
        let trunk = Trunk::new(settings, spec)?;
        let action = FieldType::from_irreps(settings.group, &spec.action);
        let hidden = settings.regular(settings.actor_fields);
        Ok(Self {
            actor: head(trunk.out_type(), hidden, action)?,
            critic: critic(settings, &trunk)?,
            action_order: irrep_order(settings.group, &spec.action),
            trunk,
        })
    }

    /// Length of the flat parameter slice.
    pub fn num_params(&self) -> usize {
        self.parts().log_std.end
    }

    /// Where the parameters of the image encoder lie.
    pub fn encoder(&self) -> Range<usize> {
        self.trunk.encoder()
    }

    /// Where all the other parameters lie.
    pub fn heads(&self) -> Range<usize> {
        self.encoder().end..self.num_params()
    }

    /// F, the length of the invariant features: one per regular field of the group.
    pub fn feature_dim(&self) -> usize {
        self.trunk.feature_dim()
    }

    /// The settings that the network was built with.
    pub fn settings(&self) -> &NetworkSettings {
        &self.trunk.settings
    }

    /// The spec that the network was built for.
    pub fn spec(&self) -> &EnvSpec {
        &self.trunk.spec
    }

    /// Draws all parameters: weights followed by a ReLU with gain sqrt(2), the last layers with
    /// their own gain, zero biases, log_std as set.
    pub fn init(&self, rng: &mut dyn Rng) -> Vec<T> {
        let (parts, settings) = (self.parts(), self.settings());
        let mut params = self.trunk.init(self.num_params(), rng);
        self.actor
            .init_scaled(rng, settings.action_gain.into(), &mut params[parts.actor]);
        self.critic
            .init_scaled(rng, settings.value_gain.into(), &mut params[parts.critic]);
        params[parts.log_std].fill(T::from_f64(settings.log_std.into()));
        params
    }

    pub(crate) fn parts(&self) -> Parts {
        let mut layout = Layout::after(&self.trunk);
        Parts {
            actor: layout.next(self.actor.num_params()),
            critic: layout.next(self.critic.num_params()),
            log_std: layout.next(self.action_order.len()),
        }
    }
}

impl<T> OnTrunk<T> for ActorCritic<T> {
    fn trunk(&self) -> &Trunk<T> {
        &self.trunk
    }
}

/// From the fields before or after pooling to the value.
fn critic<T: Scalar>(
    settings: &NetworkSettings,
    trunk: &Trunk<T>,
) -> Result<Sequential<T>, RlError> {
    let (group, value) = (settings.group, settings.group.trivial(1));
    match settings.critic {
        Critic::Pooled { width } => {
            let features = group.trivial(trunk.feature_dim());
            head(features, group.trivial(width), value)
        }
        Critic::Joint { fields } => head(trunk.out_type(), settings.regular(fields), value),
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use symmetry::{Group, Irrep};

    use super::*;

    fn spec(image: [usize; 3]) -> EnvSpec {
        let vector = vec![Irrep::X, Irrep::Y, Irrep::Trivial, Irrep::Trivial];
        EnvSpec {
            num_envs: 1,
            image,
            action: vector.clone(),
            vector,
        }
    }

    #[test]
    fn parts_cover_the_parameters_and_start_as_set() {
        let network =
            ActorCritic::<f32>::new(&NetworkSettings::default(), &spec([48, 48, 6])).unwrap();
        let params = network.init(&mut ChaCha8Rng::seed_from_u64(0));
        assert_eq!(params.len(), network.num_params());
        assert_eq!(
            (network.encoder().start, network.encoder().end),
            (0, network.heads().start)
        );
        assert_eq!(
            (network.heads().end, network.feature_dim()),
            (params.len(), 64)
        );
        assert_eq!(params[params.len() - 4..], [-0.5; 4]);
        let actor_out = &params[network.parts().actor.end - 4 * 32..network.parts().actor.end];
        assert!(actor_out.iter().all(|w| w.abs() < 0.02) && actor_out.iter().any(|&w| w != 0.0));
    }

    /// Settings of an encoder, sides of pictures that fit it and that do not, and what is said of
    /// those.
    fn sides() -> [(NetworkSettings, usize, [usize; 2], &'static str); 3] {
        [
            (NetworkSettings::default(), 48, [50, 8], "multiples of 16"),
            (NetworkSettings::keypoints(), 12, [50, 2], "multiples of 4"),
            (
                NetworkSettings::so2_128(),
                128,
                [64, 256],
                "exactly 128 x 128",
            ),
        ]
    }

    #[test]
    fn image_sizes_that_break_exactness_are_refused_with_the_sizes_that_work() {
        for group in Group::ALL {
            for (settings, right, wrong, expected) in sides() {
                let settings = NetworkSettings { group, ..settings };
                let new = |image| ActorCritic::<f32>::new(&settings, &spec(image)).err();
                assert!(new([right, right, 6]).is_none());
                for side in wrong {
                    let message = new([side, side, 6]).unwrap().to_string();
                    assert!(message.contains(expected), "{message}");
                    assert!(message.contains(&format!("{side} x {side}")), "{message}");
                }
                assert!(matches!(
                    new([48, 64, 6]).unwrap(),
                    RlError::NotSquare {
                        height: 48,
                        width: 64
                    }
                ));
            }
        }
    }

    #[test]
    fn networks_of_all_groups_are_equally_wide() {
        for group in Group::ALL {
            let settings = NetworkSettings {
                group,
                ..NetworkSettings::default()
            };
            let network = ActorCritic::<f32>::new(&settings, &spec([48, 48, 6])).unwrap();
            assert_eq!(network.trunk.out_type().dim(), 4 * 64);
            assert_eq!(network.feature_dim(), 4 * 64 / group.order());
        }
    }
}
