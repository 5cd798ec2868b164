//! Layer traits of steerable convolutions.

use std::fmt;

use rand::Rng;
use symmetry::{FieldType, Group};

use crate::conv::dispatch;
use crate::conv::maps::{ConvInput, FeatureMaps, FeatureMapsMut};
use crate::conv::operands::{ConvBackwardOperands, ConvForwardOperands, ConvOutput};
pub use crate::conv::r2_conv::R2Conv;
use crate::error::LayerError;
use crate::layers::check::TestLayer;
use crate::layers::layer::{Layer, LayerKind, LayerSignature, Scalar};
use crate::scratch::BackwardArgs;
use crate::shape::Shape;
use crate::window::SlidingWindow;

impl LayerSignature for R2Conv {
    fn in_shape(&self) -> Shape {
        self.image_shape()
    }

    fn out_shape(&self) -> Shape {
        self.out_shape
    }

    fn num_params(&self) -> usize {
        self.irrep_weights.num_params()
    }

    fn scratch_len(&self, samples: usize) -> usize {
        dispatch::scratch_len(self, samples, false)
    }
}

impl<T: Scalar> Layer<T> for R2Conv {
    fn kind(&self) -> LayerKind<'_, T> {
        LayerKind::R2Conv(self)
    }

    fn run_init(&self, rng: &mut dyn Rng, gain: f64, params: &mut [T]) {
        // weights are drawn block by block and then moved to the interleaved order of the kernels
        let mut drawn = params.to_vec();
        self.irrep_weights.init(rng, gain, &mut drawn);
        params.copy_from_slice(&drawn);
        for (&place, &weight) in self.weights.param_indices.iter().zip(&drawn) {
            params[place] = weight;
        }
    }

    fn run_forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]) {
        let pass = ConvForwardOperands {
            conv: self,
            samples: x.len() / self.image_shape().len(),
            params,
            x: ConvInput::Channels(x),
            output: ConvOutput {
                lines: 0..self.out_shape.height,
                y: FeatureMapsMut::Channels(y),
                masks: None,
            },
            scratch,
        };
        pass.run_on_threads();
    }

    fn run_backward(&self, args: BackwardArgs<T>) {
        T::backward(ConvBackwardOperands {
            conv: self,
            samples: args.x.len() / self.image_shape().len(),
            params: args.params,
            x: ConvInput::Channels(args.x),
            dy: FeatureMaps::Channels(args.dy),
            masks: None,
            dx: args.dx.map(FeatureMapsMut::Channels),
            dparams: args.dparams,
            scratch: args.scratch,
        });
    }
}

impl fmt::Display for R2Conv {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (from, to, window) = (self.image_shape(), self.out_shape, self.patches.window);
        let parameters = self.irrep_weights.num_params();
        write!(f, "R2Conv({from} -> {to}, {window} | {parameters} parameters)")
    }
}

/// Returns examples of [`R2Conv`] for the tests that run on every kind of layer.
pub(super) fn test_layers<T: Scalar>(group: Group) -> Result<Vec<TestLayer<T>>, LayerError> {
    let conv = |from, to, [size, stride, padding]: [usize; 3], image| {
        R2Conv::new(from, to, SlidingWindow::new(size, stride, padding), image)
    };
    let regular = |n| group.regular_type(n);
    let mixed = FieldType::new(group, [2, 1, 3, 0]);
    let lacking = FieldType::new(group, [1, 2, 0, 2]);
    let first = conv(group.trivial_type(6), regular(4), [4, 2, 1], [6, 8])?;
    let even = conv(regular(8), regular(2), [2, 2, 0], [4, 6])?;
    let flatten = R2Conv::flattening(Shape::image(3, 3, regular(2)), mixed)?;
    Ok(vec![
        TestLayer::approximate("4x4/2", first),
        TestLayer::approximate("3x3", conv(regular(2), regular(3), [3, 1, 0], [3, 3])?),
        TestLayer::approximate("3x3/2", conv(mixed, lacking, [3, 2, 1], [5, 7])?),
        TestLayer::approximate("5x5", conv(regular(1), mixed, [5, 1, 2], [4, 3])?),
        TestLayer::approximate("2x2", even),
        TestLayer::approximate("1x1", conv(mixed, mixed, [1, 1, 0], [2, 3])?),
        TestLayer::approximate("flatten", flatten),
    ])
}
