//! Policies in ordinary layers, for programs that know no steerable ones.

use std::ops::Range;

use equivariant::{Dense, Kernel, LayerKind, Sequential, Signature, hadamard};
use symmetry::Group;

use crate::encoder::{Encoder, POOLING};
use crate::env::{EnvSpec, Observations};
use crate::error::RlError;
use crate::trunk::Trunk;

/// An ordinary layer. Between layers, channels are those of the regular basis, in which a group
/// permutes them and a ReLU is that of every library.
#[derive(Clone, Debug, PartialEq)]
pub enum ExportedLayer {
    /// A cross-correlation, or, on vectors, a matrix product.
    Linear {
        /// `[C_out, C_in, size, size]`.
        weight: Vec<f32>,
        /// The weight's shape.
        shape: [usize; 4],
        /// `[C_out]`.
        bias: Vec<f32>,
        /// Stride and padding.
        window: Kernel,
    },
    /// max(x, 0).
    Relu,
    /// The largest value of a window.
    MaxPool(Kernel),
}

/// Distribution of actions that an actor's last layer describes.
#[derive(Clone, Debug, PartialEq)]
pub enum Distribution {
    /// A Gaussian: the means `[A]`.
    Gaussian {
        /// Logarithms of the standard deviations `[A]`, the same for every state.
        log_std: Vec<f32>,
    },
    /// The tanh of a Gaussian: means `[A]`, then `[A]` numbers whose tanh, in [-1, 1], is brought
    /// to the range of log_std.
    TanhGaussian {
        /// The range.
        log_std: [f32; 2],
    },
}

/// A policy in ordinary layers.
///
/// ```text
/// image  [C, H, W], bytes b as b / 255 - 0.5 -> image layers  -> [G n, 1, 1], element-major
/// vector [D], in natural order               -> vector layers -> [G m]
/// [image, vector]                            -> actor         -> of actions, in natural order
/// [image, vector], or maxima over G of each  -> critic        -> value [1]
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct ExportedPolicy {
    /// Sizes and types of observations and actions.
    pub spec: EnvSpec,
    /// G, the order of its group: how many channels a regular field has.
    pub order: usize,
    /// Layers of the picture; none where it looks at no picture.
    pub image: Option<Vec<ExportedLayer>>,
    /// Layers of the vector; none where there is none.
    pub vector: Option<Vec<ExportedLayer>>,
    /// Layers of the actor.
    pub actor: Vec<ExportedLayer>,
    /// Meaning of the actor's output.
    pub distribution: Distribution,
    /// Layers of the critic, and whether it reads maxima over G; none where a policy says no value.
    pub critic: Option<(Vec<ExportedLayer>, bool)>,
}

/// Output of a policy for N observations.
#[derive(Clone, Debug, PartialEq)]
pub struct PolicyOutput {
    /// Mean actions `[N, A]`: what an evaluation executes.
    pub actions: Vec<f32>,
    /// Logarithms of standard deviations `[N, A]`, before a tanh where there is one.
    pub log_std: Vec<f32>,
    /// Values `[N]`, where the policy says some.
    pub values: Option<Vec<f32>>,
}

/// A policy that can be written in ordinary layers.
pub trait ExportPolicy {
    /// Returns the policy in ordinary layers; outputs differ by rounding.
    ///
    /// # Errors
    /// [`RlError::NotExportable`] for a network with parts that are no ordinary layers.
    fn export(&self) -> Result<ExportedPolicy, RlError>;

    /// Returns its output for observations, for comparison.
    ///
    /// # Errors
    /// [`RlError::Shape`] for observations of other environments.
    fn output(&mut self, observations: &Observations) -> Result<PolicyOutput, RlError>;
}

/// Kind of an end of a chain of layers.
#[derive(Clone, Copy)]
pub(crate) enum Basis<'a> {
    /// Channels of the regular basis.
    Regular,
    /// Components in natural order: this is the index of every irrep-major one.
    Natural(&'a [usize]),
    /// Regular channels of the picture, then of the vector; so many fields of each.
    Joined([usize; 2]),
}

/// The layers of the picture and of the vector, and the end that heads begin at.
pub(crate) struct ExportedTrunk {
    pub image: Option<Vec<ExportedLayer>>,
    pub vector: Option<Vec<ExportedLayer>>,
    pub joined: Basis<'static>,
}

/// A trunk in ordinary layers.
///
/// # Errors
/// [`RlError::NotExportable`].
pub(crate) fn trunk(trunk: &Trunk<f32>, params: &[f32]) -> Result<ExportedTrunk, RlError> {
    let (group, parts, spec) = (trunk.settings.group, trunk.parts(), &trunk.spec);
    let refused = match trunk.settings.encoder {
        Encoder::Keypoints { .. } => Some("an encoder of keypoints"),
        Encoder::Strided { .. } | Encoder::Pooled { .. } if spec.image[0] != spec.image[1] => {
            Some("an encoder of images that are not square")
        }
        _ => None,
    };
    if let (Some(part), Some(_)) = (refused, parts.encoder) {
        return Err(RlError::NotExportable { part });
    }
    let channels: Vec<usize> = (0..spec.image[2]).collect();
    let plain = |layers: Option<&Sequential<f32>>, own, order| {
        let bases = [Basis::Natural(order), Basis::Regular];
        let layers = layers.map(|layers| chain(group, layers, &params[own], bases));
        layers.transpose()
    };
    let fields = |layers: &Sequential<f32>| layers.out_shape().len() / group.order();
    let joined = [parts.encoder, parts.vector].map(|layers| layers.map_or(0, fields));
    let vector = trunk.encoder().end..trunk.num_params();
    Ok(ExportedTrunk {
        image: plain(parts.encoder, trunk.encoder(), &channels)?,
        vector: plain(parts.vector, vector, parts.vector_order)?,
        joined: Basis::Joined(joined),
    })
}

/// A chain of layers; the bases of chains are vectors, or a picture.
///
/// # Errors
/// [`RlError::NotExportable`].
pub(crate) fn chain(
    group: Group,
    layers: &Sequential<f32>,
    params: &[f32],
    [input, output]: [Basis<'_>; 2],
) -> Result<Vec<ExportedLayer>, RlError> {
    let all = layers.layers();
    let mut start = 0;
    let mut plain = Vec::new();
    for (index, layer) in all.iter().enumerate() {
        let own: Range<usize> = start..start + layer.num_params();
        start = own.end;
        let bases = [
            if index == 0 { input } else { Basis::Regular },
            if index + 1 == all.len() { output } else { Basis::Regular },
        ];
        let kind = layer.kind();
        plain.push(match kind.dense() {
            Some(dense) => linear(group, &dense, &params[own], bases),
            None => weightless(&kind)?,
        });
    }
    Ok(plain)
}

/// A layer without weights.
fn weightless(kind: &LayerKind<'_, f32>) -> Result<ExportedLayer, RlError> {
    match kind {
        LayerKind::Relu => Ok(ExportedLayer::Relu),
        LayerKind::MaxPool(POOLING) => Ok(ExportedLayer::MaxPool(POOLING)),
        _ => {
            let part = "a layer without weights that is neither ReLU nor 2 x 2 max-pooling";
            Err(RlError::NotExportable { part })
        }
    }
}

fn linear(group: Group, dense: &Dense<'_>, params: &[f32], bases: [Basis<'_>; 2]) -> ExportedLayer {
    let shape = dense.kernel_shape();
    let [outputs, inputs, size, _] = shape;
    let taps = size * size;
    let mut weight = dense.kernel(params);
    let mut bias = dense.bias(params);
    for row in weight.chunks_exact_mut(inputs * taps) {
        change(group, bases[0], taps, row);
    }
    change(group, bases[1], inputs * taps, &mut weight);
    change(group, bases[1], 1, &mut bias);
    debug_assert_eq!(bias.len(), outputs);
    ExportedLayer::Linear { weight, shape, bias, window: dense.window() }
}

/// Brings the first axis of `[channels, inner]` values from the irrep basis to that of an end.
fn change(group: Group, end: Basis<'_>, inner: usize, values: &mut [f32]) {
    let irreps = match end {
        Basis::Natural(_) => values.to_vec(),
        Basis::Regular | Basis::Joined(_) => {
            hadamard(group, values);
            values.to_vec()
        }
    };
    let order = match end {
        Basis::Regular => return,
        Basis::Natural(order) => order.to_vec(),
        Basis::Joined(fields) => joined_order(group.order(), fields),
    };
    for (from, to) in irreps.chunks_exact(inner).zip(order) {
        values[to * inner..][..inner].copy_from_slice(from);
    }
}

/// Places of the channels of `[G, image fields and vector fields]` once those of the picture come
/// first.
fn joined_order(order: usize, [image, vector]: [usize; 2]) -> Vec<usize> {
    let both = image + vector;
    let place = |channel: usize| {
        let (element, field) = (channel / both, channel % both);
        match field.checked_sub(image) {
            None => element * image + field,
            Some(field) => order * image + element * vector + field,
        }
    };
    (0..order * both).map(place).collect()
}

#[cfg(test)]
mod tests {
    use equivariant::{AveragePool, FieldType, Layer, MaxPool, Relu, Shape};

    use super::*;

    #[test]
    fn layers_without_weights_are_told_apart() {
        let shape = Shape { height: 4, width: 4, fields: FieldType::new(Group::D2, [2; 4]) };
        let plain = |layer: &dyn Layer<f32>| weightless(&layer.kind()).ok();
        let (relu, pool) = (Relu::new(shape).unwrap(), MaxPool::new(shape, POOLING));
        assert_eq!(plain(&relu), Some(ExportedLayer::Relu));
        assert_eq!(plain(&pool.unwrap()), Some(ExportedLayer::MaxPool(POOLING)));
        let halving = AveragePool::new(shape, POOLING).unwrap();
        assert_eq!(plain(&halving), None);
        let wide = Kernel { size: 4, ..POOLING };
        assert_eq!(plain(&MaxPool::new(shape, wide).unwrap()), None);
    }
}
