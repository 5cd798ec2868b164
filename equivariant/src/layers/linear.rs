//! Equivariant linear layers on vectors.

use std::fmt;

use rand::Rng;
use symmetry::{FieldType, Group, Irrep};

use crate::error::LayerError;
use crate::layers::check::TestLayer;
use crate::layers::layer::{Layer, LayerKind, LayerSignature, Scalar};
use crate::scratch::BackwardArgs;
use crate::shape::{Shape, checked_product};
use crate::steerable::dense::OrdinaryConv;
use crate::steerable::irrep_weights::{IrrepChannels, IrrepWeights};
use crate::steerable::taps::TapBasis;
use crate::window::SlidingWindow;

/// Layer that maps vectors linearly, with a bias on the trivial irrep.
///
/// By Schur's lemma it mixes channels of the same irrep only: y_b = W_b x_b. The parameters are W_b
/// `[out multiplicity of b, in multiplicity of b]` in irrep order, then the bias.
#[derive(Clone, Debug)]
pub struct Linear {
    in_type: FieldType,
    out_type: FieldType,
    irrep_weights: IrrepWeights,
}

impl Linear {
    /// Creates the linear map between two field types; output channels of an irrep that the input
    /// lacks are zero, up to the bias.
    ///
    /// # Errors
    /// When the groups of the types differ, or one of them has no channels.
    pub fn new(in_type: FieldType, out_type: FieldType) -> Result<Linear, LayerError> {
        let layer = "Linear";
        LayerError::check_groups(layer, in_type, out_type)?;
        LayerError::check_feature_map_size(layer, Shape::vector(in_type), 0)?;
        LayerError::check_feature_map_size(layer, Shape::vector(out_type), 0)?;
        let weights = checked_product([in_type.dim(), out_type.dim()]);
        weights.ok_or(LayerError::TooManyValues { layer, what: "a matrix" })?;
        let cols = Irrep::ALL.map(|b| in_type.multiplicity(b));
        Ok(Linear { in_type, out_type, irrep_weights: IrrepWeights::new(cols, out_type) })
    }

    /// Returns an ordinary convolution of one tap equal to the layer, for checks and export.
    pub fn as_ordinary_conv(&self) -> OrdinaryConv<'_> {
        OrdinaryConv {
            layer_name: "Linear",
            taps: TapBasis::new(self.in_type, 1),
            irrep_weights: &self.irrep_weights,
            param_indices: None,
            window: SlidingWindow::new(1, 1, 0),
            in_shape: Shape::vector(self.in_type),
            out_shape: Shape::vector(self.out_type),
        }
    }
}

impl LayerSignature for Linear {
    fn in_shape(&self) -> Shape {
        Shape::vector(self.in_type)
    }

    fn out_shape(&self) -> Shape {
        Shape::vector(self.out_type)
    }

    fn num_params(&self) -> usize {
        self.irrep_weights.num_params()
    }
}

impl<T: Scalar> Layer<T> for Linear {
    fn kind(&self) -> LayerKind<'_, T> {
        LayerKind::Linear(Box::new(self.as_ordinary_conv()))
    }

    fn run_init(&self, rng: &mut dyn Rng, gain: f64, params: &mut [T]) {
        self.irrep_weights.init(rng, gain, params);
    }

    fn run_forward(&self, params: &[T], x: &[T], y: &mut [T], _scratch: &mut [T]) {
        self.irrep_weights.fill_bias(params, y);
        for b in Irrep::ALL {
            self.irrep_weights.add_product(b, params, IrrepChannels::new(self.in_type, b, x), y);
        }
    }

    fn run_backward(&self, args: BackwardArgs<T>) {
        let (params, dy, dparams) = (args.params, args.dy, args.dparams);
        self.irrep_weights.add_bias_gradient(dy, dparams);
        for b in Irrep::ALL {
            let x = IrrepChannels::new(self.in_type, b, args.x);
            self.irrep_weights.add_weight_gradient(b, x, dy, dparams);
        }
        let Some(dx) = args.dx else { return };
        for b in Irrep::ALL {
            let start = self.in_type.channel_range(b).start;
            let channels = dx.get_mut(start..).unwrap_or_default();
            self.irrep_weights.write_input_gradient(b, params, dy, channels, self.in_type.dim());
        }
    }
}

impl fmt::Display for Linear {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (from, to, parameters) = (self.in_type, self.out_type, self.irrep_weights.num_params());
        write!(f, "Linear({from} -> {to} | {parameters} parameters)")
    }
}

/// Returns examples of [`Linear`] for the tests that run on every kind of layer.
pub(super) fn test_layers<T: Scalar>(group: Group) -> Result<Vec<TestLayer<T>>, LayerError> {
    let mixed = FieldType::new(group, [2, 1, 3, 0]);
    let lacking = FieldType::new(group, [1, 2, 0, 2]);
    let from_mixed = Linear::new(mixed, group.regular_type(4))?;
    Ok(vec![
        TestLayer::approximate("linear", Linear::new(group.regular_type(3), lacking)?),
        TestLayer::approximate("linear from mixed", from_mixed),
    ])
}
