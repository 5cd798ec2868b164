//! Network of soft actor-critic: actor and twin critics.

use std::ops::Range;

use equivariant::{Concat, FieldType, Layer, LayerSignature, Scalar, Sequential, Shape};
use rand::Rng;
use symmetry::{Irrep, irrep_major_permutation};

use crate::distributions::unsquash_log_std;
use crate::env::EnvSpec;
use crate::error::{RlError, require, require_network_memory};
use crate::network_settings::{CriticSettings, NetworkSettings};
use crate::sac::context::ContextReader;
use crate::sac::settings::RecurrentContextSettings;
use crate::trunk::{HasTrunk, ParamAllocator, Trunk, head};

/// Network of soft actor-critic: actor and twin critics on shared equivariant features.
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
/// The contexts exist only with [`RecurrentContextSettings`]. Every part is equivariant under
/// [`NetworkSettings::group`]: the mean is of the action's type, log_std and Q are invariant
/// (D. Wang et al., "SO(2)-equivariant reinforcement learning", ICLR 2022, section 5.2).
///
/// Only the critics' loss trains the encoder, and the target critics use the same encoder instead
/// of a lagging copy (Yarats et al., "Mastering visual continuous control", ICLR 2022, section
/// 3.1), which would cost as much as all the rest.
///
/// The network owns no weights. Parameters are one flat slice: the shared part's, the actor's, then
/// the critics' ([`SacNetwork::critic_param_range`]).
pub struct SacNetwork<T> {
    pub(super) trunk: Trunk<T>,
    /// Layer that computes the input of actor and critics from an observation and the steps before
    /// it; both have separate parameters for it.
    pub(super) reader: ContextReader,
    pub(super) actor: Sequential<T>,
    pub(super) critic: Sequential<T>,
    /// Concatenation of the context reader's output and the action, the input of a critic.
    pub(super) critic_input: Concat,
    /// Indices of the components of the action in the environment's order, sorted by irrep
    /// (irrep-major order).
    pub(super) action_order: Vec<usize>,
    /// Indices of the components of (mean, log_std) in the environment's order, sorted by irrep
    /// (irrep-major order).
    pub(super) output_order: Vec<usize>,
    context: Option<RecurrentContextSettings>,
}

/// Ranges of the parameters of actor, critics and their context readers in the network's flat
/// parameter slice.
#[derive(Clone, Debug)]
pub(super) struct SacParamRanges {
    pub actor_reader: Range<usize>,
    pub actor: Range<usize>,
    pub critics: CriticParamRanges,
}

/// Ranges of the critics' parameters, in the network's flat parameter slice or in that of the
/// target critics.
#[derive(Clone, Debug)]
pub(super) struct CriticParamRanges {
    pub reader: Range<usize>,
    pub twins: [Range<usize>; 2],
}

impl<T: Scalar> SacNetwork<T> {
    /// Builds the network for the images, vectors and actions of `spec`, whose number of
    /// environments is ignored.
    ///
    /// # Errors
    /// [`RlError::UnsupportedImageSize`] for images on which the convolutions would not be exactly
    /// equivariant, [`RlError::EmptySpec`] for empty sizes, and [`RlError::InvalidSetting`] for
    /// sizes out of range, for a [`CriticSettings::Pooled`], which cannot take an action as input,
    /// and for a log_std outside the distribution's range.
    pub fn new(
        settings: &NetworkSettings,
        context: Option<RecurrentContextSettings>,
        spec: &EnvSpec,
    ) -> Result<Self, RlError> {
        let trunk = Trunk::new(settings, spec)?;
        spec.require_continuous("soft actor-critic")?;
        let fields = joint_fields(settings)?;
        let raw = unsquash_log_std(settings.log_std.into());
        let expected = "a number in (-5, 2) for soft actor-critic";
        require("log_std", settings.log_std, expected, raw.is_some())?;
        let reader = ContextReader::new(trunk.out_type(), context, spec)?;
        let group = settings.group;
        // the mean transforms like the action, log_std is invariant
        let mut output = spec.action_irreps.clone();
        output.extend(spec.action_irreps.iter().map(|_| Irrep::Trivial));
        let action = Shape::vector(FieldType::from_irreps(group, &spec.action_irreps));
        let critic_input = Concat::new(Shape::vector(reader.out_type()), action)?;
        let hidden = settings.regular_field_type(settings.actor_fields);
        let to = FieldType::from_irreps(group, &output);
        let network = Self {
            actor: head(reader.out_type(), hidden, to)?,
            critic: head(critic_input.out_shape().fields, fields, group.trivial_type(1))?,
            critic_input,
            action_order: irrep_major_permutation(group, &spec.action_irreps),
            output_order: irrep_major_permutation(group, &output),
            trunk,
            reader,
            context,
        };
        require_network_memory(network.num_params())?;
        Ok(network)
    }

    /// Returns the number of parameters of the network, which is the length of its flat parameter
    /// slice.
    pub fn num_params(&self) -> usize {
        self.critic_param_range().end
    }

    /// Returns the range of the critics' parameters, of which the target critics are a lagging
    /// copy.
    pub fn critic_param_range(&self) -> Range<usize> {
        let critics = self.param_ranges().critics;
        critics.reader.start..critics.twins[1].end
    }

    /// Returns the settings that the network was built with.
    pub fn settings(&self) -> &NetworkSettings {
        &self.trunk.settings
    }

    /// Returns the settings of the recurrent context; `None` for a network without one.
    pub fn context_settings(&self) -> Option<RecurrentContextSettings> {
        self.context
    }

    /// Returns the sizes and irreps of observations and actions that the network was built for.
    pub fn spec(&self) -> &EnvSpec {
        &self.trunk.spec
    }

    /// Samples the initial values of all parameters of the network. Weights before a ReLU have gain
    /// sqrt(2), the last layers the gains of the settings, and GRUs gain 1. Biases are zero, except
    /// those of log_std, which give the initial log_std of the settings.
    pub fn init_params(&self, rng: &mut dyn Rng) -> Vec<T> {
        let (ranges, settings) = (self.param_ranges(), self.settings());
        let mut params = self.trunk.init_params(self.num_params(), rng);
        self.reader.init(rng, &mut params[ranges.actor_reader]);
        let actor = &mut params[ranges.actor];
        self.actor.init_with_gain(rng, settings.action_gain.into(), actor);
        // a linear layer's last parameters are the biases of its trivial channels, of which
        // log_std's come last
        let log_std = actor.len() - self.action_order.len();
        let raw = unsquash_log_std(settings.log_std.into()).unwrap_or_default();
        actor[log_std..].fill(T::from_f64(raw));
        self.reader.init(rng, &mut params[ranges.critics.reader]);
        for twin in ranges.critics.twins {
            self.critic.init_with_gain(rng, settings.value_gain.into(), &mut params[twin]);
        }
        params
    }

    /// Reorders outputs of the actor, `[n, 2 A]`, from irrep-major order to the environment's
    /// order.
    pub(super) fn output_in_env_order(&self, from: &[T], to: &mut [f64]) {
        let width = self.output_order.len();
        for (target, output) in to.chunks_exact_mut(width).zip(from.chunks_exact(width)) {
            for (&i, y) in self.output_order.iter().zip(output) {
                target[i] = y.to_f64();
            }
        }
    }

    /// Returns the maximum number of steps that the actor remembers and the length of each step's
    /// fields h; zeros without a context.
    pub(super) fn memory_sizes(&self) -> [usize; 2] {
        match self.reader.max_steps() {
            0 => [0; 2],
            length => [length, self.trunk.out_type().dim()],
        }
    }

    pub(super) fn param_ranges(&self) -> SacParamRanges {
        let mut layout = ParamAllocator::starting_after_trunk(&self.trunk);
        SacParamRanges {
            actor_reader: layout.allocate(self.reader.num_params()),
            actor: layout.allocate(self.actor.num_params()),
            critics: self.critic_param_ranges(layout),
        }
    }

    /// Returns the ranges of the target critics' parameters in the slice that holds only these.
    pub(super) fn target_param_ranges(&self) -> CriticParamRanges {
        self.critic_param_ranges(ParamAllocator::new())
    }

    fn critic_param_ranges(&self, mut layout: ParamAllocator) -> CriticParamRanges {
        CriticParamRanges {
            reader: layout.allocate(self.reader.num_params()),
            twins: [(); 2].map(|()| layout.allocate(self.critic.num_params())),
        }
    }
}

impl<T> HasTrunk<T> for SacNetwork<T> {
    fn trunk(&self) -> &Trunk<T> {
        &self.trunk
    }
}

/// Returns the field type of the hidden layer of critics that read the same fields as the actor;
/// rejects other critics.
fn joint_fields(settings: &NetworkSettings) -> Result<FieldType, RlError> {
    match settings.critic {
        CriticSettings::Joint { fields } => Ok(settings.regular_field_type(fields)),
        CriticSettings::Pooled { width } => Err(RlError::InvalidSetting {
            name: "critic.pooled.width",
            value: width as f64,
            expected: "a joint critic, since one on pooled features cannot take the action",
        }),
    }
}
