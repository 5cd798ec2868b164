//! Settings of the actor-critic network.

use equivariant::FieldType;
use serde::{Deserialize, Serialize};
use symmetry::Group;

use crate::encoder::{EncoderSettings, num_group_fields};
use crate::error::{RlError, require_log_std, require_positive, require_width};

/// Settings of an [`crate::ActorCritic`] or a [`crate::SacNetwork`]: symmetry group, image encoder,
/// layer widths, and initial values of the parameters. The default is the network tuned for images
/// of 48 x 48 pixels.
///
/// In a file, a field that is missing has its default, and one that does not exist is an error.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetworkSettings {
    /// Symmetry group of the network, exact in every layer; C1 gives an ordinary network.
    ///
    /// Widths below count regular fields of D2, blocks of four channels that the group elements
    /// permute: n fields stand for 4 n channels, whatever the group. For a subgroup G these are 4 n
    /// / |G| regular fields of |G| channels. So networks of all groups are equally wide, and the
    /// number of parameters grows as the group shrinks:
    ///
    /// ```
    /// use rl::{ActorCritic, EnvSpec, NetworkSettings};
    /// use symmetry::{Group, Irrep};
    ///
    /// let xy = vec![Irrep::X, Irrep::Y, Irrep::Trivial];
    /// let spec = EnvSpec {
    ///     num_envs: 1,
    ///     image_shape: [48, 48, 6],
    ///     vector_irreps: xy.clone(),
    ///     action_irreps: xy,
    ///     choices: vec![],
    /// };
    /// let parameters = |group| {
    ///     let settings = NetworkSettings { group, ..NetworkSettings::default() };
    ///     ActorCritic::<f32>::new(&settings, &spec).map(|network| network.num_params())
    /// };
    /// let counts = [parameters(Group::D2)?, parameters(Group::C2)?, parameters(Group::C1)?];
    /// assert_eq!(counts, [62_225, 124_445, 248_887]);
    /// # Ok::<(), rl::RlError>(())
    /// ```
    ///
    /// The number of features grows, too: `top_fields + vector_fields` for D2, four times as many
    /// for C1.
    pub group: Group,
    /// Kind and layer widths of the image encoder, which maps an image to `top_fields` regular
    /// fields.
    pub encoder: EncoderSettings,
    /// Number of regular fields in the image encoder's output, at least 1.
    pub top_fields: usize,
    /// Number of regular fields in the features of the observation vector, at least 1.
    pub vector_fields: usize,
    /// Number of regular fields in the actor's hidden layer, at least 1.
    pub actor_fields: usize,
    /// Kind and width of the critic.
    pub critic: CriticSettings,
    /// Gain of the random initial weights of the actor's last layer, above 0; small, so that mean
    /// actions start near zero.
    pub action_gain: f32,
    /// Gain of the random initial weights of the critic's last layer, above 0.
    pub value_gain: f32,
    /// Initial logarithm of every action component's standard deviation, in [-10, 2], and not
    /// below [`PpoSettings::min_log_std`](crate::PpoSettings::min_log_std) where PPO trains it.
    pub log_std: f32,
}

/// Input and width of the critic, whose value is invariant under the group in either case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum CriticSettings {
    /// Critic that reads features pooled over the group, as in the paper. Image and vector are
    /// pooled separately, so the value cannot depend on the position of the hand (vector) relative
    /// to the object (image).
    Pooled {
        /// Number of channels in the critic's hidden layer, at least 1.
        width: usize,
    },
    /// Critic that reads the fields before pooling, through a hidden layer of regular fields, like
    /// the actor. The value can depend on the vector relative to the image.
    Joint {
        /// Number of regular fields in the critic's hidden layer, at least 1.
        fields: usize,
    },
}

impl CriticSettings {
    /// Returns the width of the critic's hidden layer: channels of a pooled critic, regular fields
    /// of a joint one.
    fn size(self) -> usize {
        match self {
            Self::Pooled { width } => width,
            Self::Joint { fields } => fields,
        }
    }
}

impl Default for NetworkSettings {
    fn default() -> Self {
        Self::with_strided_encoder(vec![4, 8, 16, 16], 32)
    }
}

impl NetworkSettings {
    /// Returns the default network settings with other widths: `halvings` regular fields after each
    /// halving of the image ([`EncoderSettings::Strided`]), and `fields` in all later layers.
    pub fn with_strided_encoder(halvings: Vec<usize>, fields: usize) -> Self {
        Self {
            group: Group::D2,
            encoder: EncoderSettings::Strided { fields: halvings },
            top_fields: fields,
            vector_fields: fields,
            actor_fields: fields,
            critic: CriticSettings::Joint { fields },
            action_gain: 0.01,
            value_gain: 1.0,
            // standard deviations of 0.6 of an action's unit (measured, docs/ppo.md)
            log_std: -0.5,
        }
    }

    /// Returns network settings for images of 128 x 128 pixels: the encoder of "SO(2)-equivariant
    /// reinforcement learning" (ICLR 2022) with n = 64 ([`EncoderSettings::Pooled`]), and the
    /// pooled critic of COVERS.
    pub fn so2_paper_128px() -> Self {
        Self {
            encoder: EncoderSettings::Pooled { fields: vec![8, 16, 32, 64], inner: [128, 64] },
            top_fields: 64,
            critic: CriticSettings::Pooled { width: 64 },
            ..Self::default()
        }
    }

    /// Returns the number of regular fields of the network's group that have as many channels as
    /// `fields` regular fields of D2.
    pub(crate) fn num_group_fields(&self, fields: usize) -> usize {
        num_group_fields(self.group, fields)
    }

    /// Returns the type of regular fields of the network's group that have as many channels as
    /// `fields` regular fields of D2.
    pub(crate) fn regular_field_type(&self, fields: usize) -> FieldType {
        self.group.regular_type(self.num_group_fields(fields))
    }

    /// Checks that every setting of the network is in its range.
    ///
    /// # Errors
    /// [`RlError::InvalidSetting`] names the field, its value and its range.
    pub fn check(&self) -> Result<(), RlError> {
        let own = [
            ("top_fields", self.top_fields),
            ("vector_fields", self.vector_fields),
            ("actor_fields", self.actor_fields),
            ("critic", self.critic.size()),
        ];
        for (name, width) in self.encoder.named_widths().into_iter().chain(own) {
            require_width(name, width)?;
        }
        for (name, value) in [("action_gain", self.action_gain), ("value_gain", self.value_gain)] {
            require_positive(name, value)?;
        }
        require_log_std("log_std", self.log_std)
    }
}
