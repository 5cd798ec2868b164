//! Steerable convolutions.

use std::fmt;

use rand::Rng;
use symmetry::FieldType;

use crate::backward_pass::BackwardPass;
use crate::conv::chain::Fusible;
use crate::conv::geometry::Conv;
use crate::conv::maps::{Input, Maps, MapsMut};
use crate::conv::pass::{Backward, Forward, Output};
use crate::conv::passes;
use crate::error::LayerError;
use crate::instruction_set::InstructionSet;
use crate::layers::layer::{Layer, Signature};
use crate::layers::scalar::Scalar;
use crate::shape::Shape;
use crate::steerable::dense::Dense;
use crate::window::Kernel;

/// A convolution that commutes with the group of its types, with a bias on the trivial irrep.
///
/// The kernel obeys k(g t) = rho_out(g) k(t) rho_in(g)^-1 (Cohen and Welling, "Steerable CNNs",
/// ICLR 2017). Between irreps a and b that is w(g t) = a(g) b(g) w(t): the signs of the irrep a b.
/// Patches are therefore folded by parity (even and odd along each axis for D2), and output irrep b
/// is one product of its folded columns with a matrix of parameters `[out multiplicity of b,
/// columns]`. The parameters of all irreps are interleaved, in the order in which the kernels read
/// them, `[folded tap and input channel, output field, irrep]`, and the bias follows;
/// [`dense`](R2Conv::dense) says what each of them does. Every steerable kernel on the grid is
/// reached. Types of C1 give an ordinary convolution whose parameters are the kernel `[size, size,
/// C_in, C_out]`.
#[derive(Clone, Debug)]
pub struct R2Conv {
    conv: Conv,
}

impl R2Conv {
    /// A convolution of maps of `[height, width]` pixels.
    ///
    /// # Errors
    /// When the groups of the types differ, a map is empty, the windows do not sit symmetrically
    /// (see [`Kernel`]) or none fits.
    pub fn new(
        in_type: FieldType,
        out_type: FieldType,
        kernel: Kernel,
        size: [usize; 2],
    ) -> Result<R2Conv, LayerError> {
        let image = Shape::image(size[0], size[1], in_type);
        let conv = Conv::new("R2Conv", image, out_type, kernel)?;
        Ok(R2Conv { conv })
    }

    /// A convolution whose window is the whole map: it flattens a square map to a vector.
    ///
    /// # Errors
    /// When the groups of the types differ or the map is not square.
    pub fn flatten(shape: Shape, out_type: FieldType) -> Result<R2Conv, LayerError> {
        let Shape { height, width, .. } = shape;
        if height != width {
            return Err(LayerError::NotSquare {
                layer: "R2Conv::flatten",
                height,
                width,
            });
        }
        let kernel = Kernel::new(height, 1, 0);
        R2Conv::new(shape.fields, out_type, kernel, [height, width])
    }

    /// The same layer on no wider instructions than these, for comparing: AVX2 and AVX-512
    /// give the same bits, and the portable code others. Double precision is portable in any case.
    pub fn at_most(mut self, widest: InstructionSet) -> R2Conv {
        self.conv.widest = widest;
        self
    }

    /// The layer as an ordinary convolution.
    pub fn dense(&self) -> Dense<'_> {
        Dense {
            name: "R2Conv",
            taps: self.conv.taps.clone(),
            blocks: &self.conv.blocks,
            places: Some(self.conv.weights.places()),
            window: self.conv.patches.kernel(),
            in_shape: self.in_shape(),
            out_shape: self.out_shape(),
        }
    }
}

impl Signature for R2Conv {
    fn in_shape(&self) -> Shape {
        self.conv.image()
    }

    fn out_shape(&self) -> Shape {
        self.conv.out
    }

    fn num_params(&self) -> usize {
        self.conv.num_params()
    }

    fn scratch_len(&self, samples: usize) -> usize {
        passes::scratch_len(&self.conv, samples, false)
    }

    fn as_dense(&self) -> Option<Dense<'_>> {
        Some(self.dense())
    }

    fn fusible(&self) -> Option<Fusible<'_>> {
        Some(Fusible::Conv(&self.conv))
    }
}

impl<T: Scalar> Layer<T> for R2Conv {
    fn draw(&self, rng: &mut dyn Rng, gain: f64, params: &mut [T]) {
        let mut drawn = params.to_vec();
        self.conv.blocks.init(rng, gain, &mut drawn);
        params.copy_from_slice(&drawn);
        for (&place, &weight) in self.conv.weights.places().iter().zip(&drawn) {
            params[place] = weight;
        }
    }

    fn run_forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]) {
        let pass = Forward {
            conv: &self.conv,
            samples: x.len() / self.in_shape().len(),
            params,
            x: Input::Channels(x),
            to: Output {
                lines: 0..self.conv.out.height,
                y: MapsMut::Channels(y),
                masks: None,
            },
            scratch,
        };
        pass.run_on_threads();
    }

    fn run_backward(&self, pass: BackwardPass<T>) {
        T::backward(Backward {
            conv: &self.conv,
            samples: pass.x.len() / self.in_shape().len(),
            params: pass.params,
            x: Input::Channels(pass.x),
            dy: Maps::Channels(pass.dy),
            masks: None,
            dx: pass.dx.map(MapsMut::Channels),
            dparams: pass.dparams,
            scratch: pass.scratch,
        });
    }
}

impl fmt::Display for R2Conv {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (from, to, window) = (
            self.in_shape(),
            self.out_shape(),
            self.conv.patches.kernel(),
        );
        let parameters = self.num_params();
        write!(
            f,
            "R2Conv({from} -> {to}, {window} | {parameters} parameters)"
        )
    }
}
