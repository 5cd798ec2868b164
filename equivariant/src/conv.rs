//! Steerable convolutions.

use std::fmt;

use rand::Rng;
use symmetry::{FieldType, Irrep};

use crate::blocks::Blocks;
use crate::conv_backward::Backward;
use crate::conv_forward::{Forward, Output};
use crate::conv_weights::Weights;
use crate::layer::Fusible;
use crate::maps::{Maps, MapsMut};
use crate::patches::Patches;
use crate::taps::Taps;
use crate::{Dense, Kernel, Layer, LayerError, Scalar, Shape};

/// Output pixels that are worth staging several images together.
const GROUP_PIXELS: usize = 64;

/// A convolution that commutes with the group of its types, with a bias on the trivial irrep.
///
/// The kernel obeys k(g t) = rho_out(g) k(t) rho_in(g)^-1 (Cohen and Welling, "Steerable CNNs",
/// ICLR 2017). Between irreps a and b that is w(g t) = a(g) b(g) w(t): the signs of the irrep a b.
/// Patches are therefore folded by parity (even and odd along each axis for D2), and output irrep b is one
/// product of its folded columns with a matrix of parameters `[out multiplicity of b, columns]`. The parameters
/// of all irreps are interleaved, in the order in which the kernels read them, `[folded tap and input channel,
/// output field, irrep]`, and the bias follows; [`dense`](R2Conv::dense) says what each of them does. Every steerable
/// kernel on the grid is reached. Types of C1 give an ordinary convolution whose parameters are the kernel
/// `[size, size, C_in, C_out]`.
#[derive(Clone, Debug)]
pub struct R2Conv {
    taps: Taps,
    patches: Patches,
    blocks: Blocks,
    weights: Weights,
    shape_out: Shape,
}

impl R2Conv {
    /// A convolution of maps of `[height, width]` pixels.
    ///
    /// # Errors
    /// When the groups of the types differ, the windows do not sit symmetrically (see [`Kernel`]) or
    /// none fits.
    pub fn new(
        in_type: FieldType,
        out_type: FieldType,
        kernel: Kernel,
        size: [usize; 2],
    ) -> Result<R2Conv, LayerError> {
        LayerError::check_groups("R2Conv", in_type, out_type)?;
        let out_size = kernel.windows("R2Conv", in_type.group(), size)?;
        let taps = Taps::new(in_type, kernel.size);
        let image = Shape::image(size[0], size[1], in_type);
        let patches = Patches::new(&taps, image, kernel, out_size);
        let blocks = Blocks::new(Irrep::ALL.map(|b| taps.cols(b)), out_type);
        Ok(R2Conv {
            weights: Weights::new(&taps, &patches, &blocks, out_type),
            taps,
            patches,
            blocks,
            shape_out: Shape::image(out_size[0], out_size[1], out_type),
        })
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
        let kernel = Kernel {
            size: height,
            stride: 1,
            padding: 0,
        };
        R2Conv::new(shape.fields, out_type, kernel, [height, width])
    }

    /// The layer as an ordinary convolution.
    pub fn dense(&self) -> Dense<'_> {
        Dense {
            name: "R2Conv",
            taps: self.taps.clone(),
            blocks: &self.blocks,
            places: Some(self.weights.places()),
            window: self.patches.kernel(),
            in_shape: self.shape_in(),
            out_shape: self.shape_out,
        }
    }

    pub(crate) fn patches(&self) -> &Patches {
        &self.patches
    }

    pub(crate) fn blocks(&self) -> &Blocks {
        &self.blocks
    }

    pub(crate) fn weights(&self) -> &Weights {
        &self.weights
    }

    pub(crate) fn shape_in(&self) -> Shape {
        self.patches.image()
    }

    pub(crate) fn shape_out(&self) -> Shape {
        self.shape_out
    }

    /// The number of samples that are staged together.
    pub(crate) fn group(&self, samples: usize) -> usize {
        let group = GROUP_PIXELS / self.shape_out.pixels().max(1);
        group.clamp(1, samples.max(1))
    }
}

impl<T: Scalar> Layer<T> for R2Conv {
    fn in_shape(&self) -> Shape {
        self.shape_in()
    }

    fn out_shape(&self) -> Shape {
        self.shape_out()
    }

    fn num_params(&self) -> usize {
        self.blocks.num_params()
    }

    fn as_dense(&self) -> Option<Dense<'_>> {
        Some(self.dense())
    }

    fn init_scaled(&self, rng: &mut dyn Rng, gain: f64, params: &mut [T]) {
        let mut drawn = params.to_vec();
        self.blocks.init(rng, gain, &mut drawn);
        params.copy_from_slice(&drawn);
        for (&place, &weight) in self.weights.places().iter().zip(&drawn) {
            params[place] = weight;
        }
    }

    fn fusible(&self) -> Option<Fusible<'_>> {
        Some(Fusible::Conv(self))
    }

    fn scratch_len(&self, samples: usize) -> usize {
        let forward = Forward::<T>::scratch_len(self, samples, false);
        forward.max(Backward::<T>::scratch_len(self, samples, false))
    }

    fn forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]) {
        let pass = Forward {
            conv: self,
            samples: self.shape_in().samples(x.len()),
            params,
            x: Maps::Channels(x),
            to: Output {
                lines: 0..self.shape_out.height,
                y: MapsMut::Channels(y),
                masks: None,
            },
            scratch,
        };
        pass.run_on_threads();
    }

    fn backward(
        &self,
        params: &[T],
        x: &[T],
        _y: &[T],
        dy: &[T],
        dx: Option<&mut [T]>,
        dparams: &mut [T],
        scratch: &mut [T],
    ) {
        T::backward(Backward {
            conv: self,
            samples: self.shape_in().samples(x.len()),
            params,
            x: Maps::Channels(x),
            dy: Maps::Channels(dy),
            masks: None,
            dx: dx.map(MapsMut::Channels),
            dparams,
            scratch,
        });
    }
}

impl fmt::Display for R2Conv {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "R2Conv({} -> {}, {} | {} parameters)",
            self.shape_in(),
            self.shape_out(),
            self.patches.kernel(),
            self.blocks.num_params()
        )
    }
}
