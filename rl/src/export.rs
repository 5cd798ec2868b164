//! Export of policies as ordinary dense layers, for programs without equivariant ones.

use equivariant::{
    LayerKind, LayerSignature, OrdinaryConv, Sequential, SlidingWindow, hadamard_transform,
};
use symmetry::Group;

use crate::encoder::POOL_WINDOW;
use crate::env::{EnvSpec, Observations};
use crate::error::RlError;
use crate::trunk::Trunk;

/// Ordinary layer of an exported policy, which any neural-network library can run. Channels between
/// layers are in the regular basis, in which a group permutes them and the pointwise ReLU of any
/// library is equivariant.
#[derive(Clone, Debug, PartialEq)]
pub enum ExportedLayer {
    /// Convolution (cross-correlation) of images, or a matrix product on vectors, which is a 1 x 1
    /// convolution.
    Linear {
        /// Kernel of the convolution, `[C_out, C_in, size, size]` for C_in input and C_out output
        /// channels.
        weight: Vec<f32>,
        /// Shape of the convolution's kernel, `[C_out, C_in, size, size]`.
        shape: [usize; 4],
        /// Bias of each of the convolution's output channels, `[C_out]`.
        bias: Vec<f32>,
        /// Size, stride and padding of the convolution's window, in pixels.
        window: SlidingWindow,
    },
    /// Pointwise rectifier (ReLU), max(x, 0).
    Relu,
    /// Max-pooling of images over a window with the given size, stride and padding in pixels.
    MaxPool(SlidingWindow),
}

/// Action distribution that the actor's last layer parametrises.
#[derive(Clone, Debug, PartialEq)]
pub enum ExportedActionDistribution {
    /// Gaussian distribution; the actor outputs its means `[A]`.
    Gaussian {
        /// Logarithms of the Gaussian's standard deviations `[A]`, the same for every state.
        log_std: Vec<f32>,
    },
    /// Tanh of a Gaussian; the actor outputs its means `[A]`, then `[A]` numbers whose tanh is
    /// scaled from [-1, 1] to the range of log_std.
    TanhGaussian {
        /// Minimum and maximum of log_std, the logarithm of the Gaussian's standard deviation.
        log_std: [f32; 2],
    },
}

/// A policy exported as ordinary layers: convolutions, matrix products, ReLUs and max-pooling.
///
/// ```text
/// image  [C, H, W], bytes b as b / 255 - 0.5 -> image layers  -> [G n, 1, 1], element-major
/// vector [D], in the environment's order     -> vector layers -> [G m]
/// [image, vector]                            -> actor         -> of actions, in that order
/// [image, vector], or maxima over G of each  -> critic        -> value [1]
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct ExportedPolicy {
    /// Sizes and symmetry types of the policy's observations and actions.
    pub spec: EnvSpec,
    /// Order G of the symmetry group, which is the number of channels of a regular field.
    pub order: usize,
    /// Layers that encode the image; `None` if the policy reads no image.
    pub image: Option<Vec<ExportedLayer>>,
    /// Layers that encode the observation vector; `None` if observations have no vector.
    pub vector: Option<Vec<ExportedLayer>>,
    /// Layers of the actor, which read the outputs of the image layers and the vector layers.
    pub actor: Vec<ExportedLayer>,
    /// Action distribution whose parameters the actor outputs.
    pub distribution: ExportedActionDistribution,
    /// Layers of the critic, and `true` if they read each field's maximum over the group instead of
    /// the fields; `None` for a policy without a value function.
    pub critic: Option<(Vec<ExportedLayer>, bool)>,
}

/// Output of a policy for N observations: mean actions, log_std and state values.
#[derive(Clone, Debug, PartialEq)]
pub struct PolicyOutput {
    /// Mean actions `[N, A]`, as an evaluation executes them.
    pub actions: Vec<f32>,
    /// Logarithms of the Gaussian's standard deviations `[N, A]`, before any tanh.
    pub log_std: Vec<f32>,
    /// State values V(s) `[N]`; `None` for a policy without a value function.
    pub values: Option<Vec<f32>>,
}

/// A policy that can be exported as ordinary layers, which any neural-network library can run.
pub trait ExportPolicy {
    /// Returns the policy as ordinary layers, whose outputs differ from the policy's by rounding
    /// only.
    ///
    /// # Errors
    /// [`RlError::NotExportable`] for a network with parts that ordinary layers cannot express.
    fn export(&self) -> Result<ExportedPolicy, RlError>;

    /// Returns the policy's own output for `observations`, with which the output of its exported
    /// layers is compared.
    ///
    /// # Errors
    /// [`RlError::ShapeMismatch`] for observations of other environments;
    /// [`RlError::NeedsEpisode`] for a policy whose output depends on earlier observations.
    fn reference_output(&mut self, observations: &Observations) -> Result<PolicyOutput, RlError>;
}

/// Basis and order of the channels at the input or output of a chain of network layers.
#[derive(Clone, Copy)]
pub(crate) enum ChannelBasis<'a> {
    /// Channels in the basis of the regular representation, ordered by group element, then by
    /// field.
    Regular,
    /// Components in the environment's order; holds the components' indices sorted by irrep
    /// (irrep-major order).
    Environment(&'a [usize]),
    /// Channels in the regular basis, those of the image before those of the vector; holds the
    /// number of regular fields of each.
    Joined([usize; 2]),
}

/// Exported layers of a [`Trunk`], and the channel basis of the input of actor and critic.
pub(crate) struct ExportedTrunk {
    pub image: Option<Vec<ExportedLayer>>,
    pub vector: Option<Vec<ExportedLayer>>,
    pub joined: ChannelBasis<'static>,
}

/// Exports the image layers and the vector layers of a [`Trunk`] as ordinary layers.
///
/// # Errors
/// [`RlError::NotExportable`] for images that are not square.
pub(crate) fn export_trunk(trunk: &Trunk<f32>, params: &[f32]) -> Result<ExportedTrunk, RlError> {
    let (group, spec) = (trunk.settings.group, &trunk.spec);
    // an environment without images has no encoder, whatever the setting says
    if trunk.encoder.is_some() && spec.image_shape[0] != spec.image_shape[1] {
        return Err(RlError::NotExportable { part: "an encoder of images that are not square" });
    }
    let channels: Vec<usize> = (0..spec.image_shape[2]).collect();
    let export = |layers: &Option<Sequential<f32>>, own, order| {
        let bases = [ChannelBasis::Environment(order), ChannelBasis::Regular];
        layers.as_ref().map(|layers| export_layers(group, layers, &params[own], bases)).transpose()
    };
    let fields = |layers: &Sequential<f32>| layers.out_shape().len() / group.order();
    let joined = [&trunk.encoder, &trunk.vector].map(|layers| layers.as_ref().map_or(0, fields));
    let vector = trunk.encoder_param_range().end..trunk.num_params();
    Ok(ExportedTrunk {
        image: export(&trunk.encoder, trunk.encoder_param_range(), &channels)?,
        vector: export(&trunk.vector, vector, &trunk.vector_order)?,
        joined: ChannelBasis::Joined(joined),
    })
}

/// Exports a chain of layers as ordinary layers, with the given channel bases of the chain's input
/// and output.
///
/// # Errors
/// [`RlError::NotExportable`] for a layer that has no ordinary form.
pub(crate) fn export_layers(
    group: Group,
    layers: &Sequential<f32>,
    params: &[f32],
    [input, output]: [ChannelBasis<'_>; 2],
) -> Result<Vec<ExportedLayer>, RlError> {
    let all = layers.layers();
    let mut exported = Vec::new();
    for (index, layer) in all.iter().enumerate() {
        let bases = [
            if index == 0 { input } else { ChannelBasis::Regular },
            if index + 1 == all.len() { output } else { ChannelBasis::Regular },
        ];
        let kind = layer.kind();
        exported.push(match kind.as_ordinary_conv() {
            Some(dense) => export_linear(group, &dense, &params[layers.param_range(index)], bases),
            None => export_parameterless(&kind)?,
        });
    }
    Ok(exported)
}

/// Exports a layer without weights: a ReLU or max-pooling.
fn export_parameterless(kind: &LayerKind<'_, f32>) -> Result<ExportedLayer, RlError> {
    match kind {
        LayerKind::Relu => Ok(ExportedLayer::Relu),
        LayerKind::MaxPool(POOL_WINDOW) => Ok(ExportedLayer::MaxPool(POOL_WINDOW)),
        _ => {
            let part = "a layer without weights that is neither ReLU nor 2 x 2 max-pooling";
            Err(RlError::NotExportable { part })
        }
    }
}

/// Exports a convolution or linear layer, with its kernel in the channel `bases` of its input and
/// output.
fn export_linear(
    group: Group,
    dense: &OrdinaryConv<'_>,
    params: &[f32],
    bases: [ChannelBasis<'_>; 2],
) -> ExportedLayer {
    let shape = dense.kernel_shape();
    let [outputs, inputs, size, _] = shape;
    let taps = size * size;
    let mut weight = dense.kernel(params);
    let mut bias = dense.bias(params);
    // the input axis of each output channel, then the output axis of kernel and bias
    for row in weight.chunks_exact_mut(inputs * taps) {
        change_basis(group, bases[0], taps, row);
    }
    change_basis(group, bases[1], inputs * taps, &mut weight);
    change_basis(group, bases[1], 1, &mut bias);
    debug_assert_eq!(bias.len(), outputs);
    ExportedLayer::Linear { weight, shape, bias, window: dense.window() }
}

/// Transforms the first axis of the array `values` `[channels, inner]` from the irrep basis to
/// `basis`.
fn change_basis(group: Group, basis: ChannelBasis<'_>, inner: usize, values: &mut [f32]) {
    // the Hadamard transform maps irreps to the regular basis of a field
    let irreps = match basis {
        ChannelBasis::Environment(_) => values.to_vec(),
        ChannelBasis::Regular | ChannelBasis::Joined(_) => {
            hadamard_transform(group, values);
            values.to_vec()
        }
    };
    let order = match basis {
        ChannelBasis::Regular => return,
        ChannelBasis::Environment(order) => order.to_vec(),
        ChannelBasis::Joined(fields) => joined_order(group.order(), fields),
    };
    for (from, to) in irreps.chunks_exact(inner).zip(order) {
        values[to * inner..][..inner].copy_from_slice(from);
    }
}

/// Returns the new index of each channel of `[G, image fields + vector fields]`, for a group of
/// `order` G, when all channels of the image are moved before those of the vector.
fn joined_order(order: usize, [image, vector]: [usize; 2]) -> Vec<usize> {
    let both = image + vector;
    let index = |channel: usize| {
        let (element, field) = (channel / both, channel % both);
        match field.checked_sub(image) {
            None => element * image + field,
            Some(field) => order * image + element * vector + field,
        }
    };
    (0..order * both).map(index).collect()
}

#[cfg(test)]
mod tests {
    use equivariant::{FieldType, GroupMaxPool, Layer, MaxPool, Relu, Shape};

    use super::*;

    #[test]
    fn layers_without_weights_are_told_apart() {
        let shape = Shape { height: 4, width: 4, fields: FieldType::new(Group::D2, [2; 4]) };
        let plain = |layer: &dyn Layer<f32>| export_parameterless(&layer.kind()).ok();
        let (relu, pool) = (Relu::new(shape).unwrap(), MaxPool::new(shape, POOL_WINDOW));
        assert_eq!(plain(&relu), Some(ExportedLayer::Relu));
        assert_eq!(plain(&pool.unwrap()), Some(ExportedLayer::MaxPool(POOL_WINDOW)));
        assert_eq!(plain(&GroupMaxPool::new(shape).unwrap()), None);
        let wide = SlidingWindow { size: 4, ..POOL_WINDOW };
        assert_eq!(plain(&MaxPool::new(shape, wide).unwrap()), None);
    }
}
