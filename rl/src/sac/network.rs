//! The network of soft actor-critic.

use std::ops::Range;

use equivariant::{Concat, FieldType, Layer, Scalar, Sequential, Shape, Signature};
use rand::Rng;
use symmetry::{Irrep, irrep_order};

use crate::distributions::raw_log_std;
use crate::env::EnvSpec;
use crate::error::{RlError, require};
use crate::network_settings::{Critic, NetworkSettings};
use crate::sac::context::ContextReader;
use crate::sac::settings::ContextSettings;
use crate::trunk::{HasTrunk, Layout, Trunk, head};

/// Actor and twin critics on shared equivariant features.
///
/// ```text
/// image  [H, W, C] -> Encoder ------+
/// vector [D]       -> Linear, ReLU -+-> h, regular fields
/// last steps [L, (h, action, reward)] -> GRU -> context, one for the actor and one for the critics
/// [h, context]         -> Linear, ReLU, Linear -> mean [A] and log_std [A] of a tanh-Gaussian
/// [h, context, action] -> Linear, ReLU, Linear -> Q, twice
/// h -> GroupMaxPool -> features [F], invariant
/// ```
///
/// The context is there for [`ContextSettings`] alone. Every part is equivariant under
/// [`NetworkSettings::group`]: the mean is of the action's type, log_std and Q are invariant
/// (D. Wang et al., "SO(2)-equivariant reinforcement learning", ICLR 2022, section 5.2).
///
/// The encoder is trained by the critics' loss alone, and there is one for now and for the targets
/// (Yarats et al., "Mastering visual continuous control", ICLR 2022, section 3.1): one more would
/// cost as much as all the rest.
///
/// It owns no weights: the parameters are one flat slice. First those of the shared part, then the
/// actor's, then the critics' ([`SacNetwork::critics`]).
pub struct SacNetwork<T> {
    pub(super) trunk: Trunk<T>,
    /// The actor and the critics read alike, with parameters of their own.
    pub(super) reader: ContextReader,
    pub(super) actor: Sequential<T>,
    pub(super) critic: Sequential<T>,
    /// Joins the reader's output and the action to what a critic reads.
    pub(super) joined: Concat,
    /// Natural index of every irrep-major component of the action, and of (mean, log_std).
    pub(super) action_order: Vec<usize>,
    pub(super) output_order: Vec<usize>,
    context: Option<ContextSettings>,
}

/// Ranges of each part's parameters in the flat slice.
#[derive(Clone, Debug)]
pub(super) struct Parts {
    pub actor_reader: Range<usize>,
    pub actor: Range<usize>,
    pub critics: CriticParts,
}

/// Ranges of the critics' parameters: in those of the network, or among themselves.
#[derive(Clone, Debug)]
pub(super) struct CriticParts {
    pub reader: Range<usize>,
    pub twins: [Range<usize>; 2],
}

impl<T: Scalar> SacNetwork<T> {
    /// The network for the images, vectors and actions of `spec`; its number of environments does
    /// not matter.
    ///
    /// # Errors
    /// [`RlError::ImageSize`] or [`RlError::OffCentre`] for images that the convolutions cannot
    /// treat exactly, [`RlError::Setting`] and [`RlError::EmptySpec`] for sizes out of range, for a
    /// [`Critic::Pooled`], which could not see where an action leads to, and for a standard
    /// deviation outside of the distribution's range.
    pub fn new(
        settings: &NetworkSettings,
        context: Option<ContextSettings>,
        spec: &EnvSpec,
    ) -> Result<Self, RlError> {
        let trunk = Trunk::new(settings, spec)?;
        let fields = joint_fields(settings)?;
        let raw = raw_log_std(settings.log_std.into());
        let expected = "a number in (-5, 2) for soft actor-critic";
        require("log_std", settings.log_std, expected, raw.is_some())?;
        let reader = ContextReader::new(trunk.out_type(), context, spec)?;
        let group = settings.group;
        let mut output = spec.action.clone();
        output.extend(spec.action.iter().map(|_| Irrep::Trivial));
        let action = Shape::vector(FieldType::from_irreps(group, &spec.action));
        let joined = Concat::new(Shape::vector(reader.out_type()), action)?;
        let hidden = settings.regular(settings.actor_fields);
        let to = FieldType::from_irreps(group, &output);
        Ok(Self {
            actor: head(reader.out_type(), hidden, to)?,
            critic: head(joined.out_shape().fields, fields, group.trivial(1))?,
            joined,
            action_order: irrep_order(group, &spec.action),
            output_order: irrep_order(group, &output),
            trunk,
            reader,
            context,
        })
    }

    /// Length of the flat parameter slice.
    pub fn num_params(&self) -> usize {
        self.critics().end
    }

    /// Range of the critics' parameters: those that have targets.
    pub fn critics(&self) -> Range<usize> {
        let critics = self.parts().critics;
        critics.reader.start..critics.twins[1].end
    }

    /// The settings that the network was built with.
    pub fn settings(&self) -> &NetworkSettings {
        &self.trunk.settings
    }

    /// The settings of the context, where there is one.
    pub fn context(&self) -> Option<ContextSettings> {
        self.context
    }

    /// The spec that the network was built for.
    pub fn spec(&self) -> &EnvSpec {
        &self.trunk.spec
    }

    /// Draws all parameters: weights followed by a ReLU with gain sqrt(2), the last layers with
    /// their own gain, those of GRUs with 1, zero biases but for log_std, which starts as set.
    pub fn init(&self, rng: &mut dyn Rng) -> Vec<T> {
        let (parts, settings) = (self.parts(), self.settings());
        let mut params = self.trunk.init(self.num_params(), rng);
        self.reader.init(rng, &mut params[parts.actor_reader]);
        let actor = &mut params[parts.actor];
        self.actor.init_scaled(rng, settings.action_gain.into(), actor);
        // biases of trivial channels are the last parameters of a linear layer, log_std's the last
        let log_std = actor.len() - self.action_order.len();
        let raw = raw_log_std(settings.log_std.into()).unwrap_or_default();
        actor[log_std..].fill(T::from_f64(raw));
        self.reader.init(rng, &mut params[parts.critics.reader]);
        for twin in parts.critics.twins {
            self.critic.init_scaled(rng, settings.value_gain.into(), &mut params[twin]);
        }
        params
    }

    /// Writes outputs of the actor, `[n, 2 A]`, in their natural order.
    pub(super) fn natural_output(&self, from: &[T], to: &mut [f64]) {
        let width = self.output_order.len();
        for (to, from) in to.chunks_exact_mut(width).zip(from.chunks_exact(width)) {
            for (&i, y) in self.output_order.iter().zip(from) {
                to[i] = y.to_f64();
            }
        }
    }

    /// Steps that an actor remembers at most, and the length of their fields; zeros without a
    /// context.
    pub(super) fn remembered(&self) -> [usize; 2] {
        match self.reader.length() {
            0 => [0; 2],
            length => [length, self.trunk.out_type().dim()],
        }
    }

    pub(super) fn parts(&self) -> Parts {
        let mut layout = Layout::after(&self.trunk);
        Parts {
            actor_reader: layout.next(self.reader.num_params()),
            actor: layout.next(self.actor.num_params()),
            critics: self.critic_parts(layout),
        }
    }

    /// Ranges of the target critics' parameters.
    pub(super) fn target_parts(&self) -> CriticParts {
        self.critic_parts(Layout::new())
    }

    fn critic_parts(&self, mut layout: Layout) -> CriticParts {
        CriticParts {
            reader: layout.next(self.reader.num_params()),
            twins: [(); 2].map(|()| layout.next(self.critic.num_params())),
        }
    }
}

impl<T> HasTrunk<T> for SacNetwork<T> {
    fn trunk(&self) -> &Trunk<T> {
        &self.trunk
    }
}

/// The hidden fields of critics that see all that the actor sees.
fn joint_fields(settings: &NetworkSettings) -> Result<FieldType, RlError> {
    match settings.critic {
        Critic::Joint { fields } => Ok(settings.regular(fields)),
        Critic::Pooled { width } => Err(RlError::Setting {
            name: "critic.pooled.width",
            value: width as f64,
            expected: "a joint critic, since one on pooled features could not see the action",
        }),
    }
}
