//! Steerable convolutions.

use std::fmt;

use rand::Rng;
use symmetry::{FieldType, Irrep};

use crate::blocks::{Blocks, Rows, RowsMut};
use crate::fold::{Fold, Matrices};
use crate::{Dense, Kernel, Layer, LayerError, Scalar, Shape};

/// Output pixels that go into one matrix product; small images are batched up to it.
const GROUP_PIXELS: usize = 144;

/// A convolution that commutes with the group of its types, with a bias on the trivial irrep.
///
/// The kernel obeys k(g t) = rho_out(g) k(t) rho_in(g)^-1 (Cohen and Welling, "Steerable CNNs",
/// ICLR 2017). Between irreps a and b that is w(g t) = a(g) b(g) w(t): the signs of the irrep a b.
/// Patches are therefore folded by parity (even and odd along each axis for D2), and output irrep b is one
/// product of its folded columns with a matrix of parameters `[out multiplicity of b, columns]`. The columns are
/// ordered by parity (in irrep order), tap (row-major) and channel; the matrices come in irrep order, then
/// the bias. Every steerable kernel on the grid is reached. Types of C1 give an ordinary convolution
/// whose parameters are the kernel `[C_out, size, size, C_in]`.
#[derive(Clone, Debug)]
pub struct R2Conv {
    fold: Fold,
    blocks: Blocks,
    out_type: FieldType,
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
        let fold = Fold::new(in_type, kernel, size, out_size);
        let blocks = Blocks::new(Irrep::ALL.map(|b| fold.cols(b)), out_type);
        Ok(R2Conv {
            fold,
            blocks,
            out_type,
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
            taps: self.fold.taps().clone(),
            blocks: &self.blocks,
            window: self.fold.kernel(),
            in_shape: self.shape_in(),
            out_shape: self.shape_out(),
        }
    }

    fn shape_in(&self) -> Shape {
        let [height, width] = self.fold.in_size();
        Shape::image(height, width, self.fold.in_type())
    }

    fn shape_out(&self) -> Shape {
        let [height, width] = self.fold.out_size();
        Shape::image(height, width, self.out_type)
    }

    /// The number of samples whose pixels share a matrix product.
    fn group(&self) -> usize {
        (GROUP_PIXELS / self.fold.out_pixels()).max(1)
    }

    /// Cuts the scratch into the lines of the fold and the matrices of a group of samples.
    fn parts<'a, T>(&self, scratch: &'a mut [T], samples: usize) -> (&'a mut [T], Matrices<'a, T>) {
        let (lines, mut rest) = scratch.split_at_mut(self.fold.lines_len());
        let rows = samples * self.fold.out_pixels();
        let matrices = Irrep::ALL.map(|b| {
            let (matrix, others) = std::mem::take(&mut rest).split_at_mut(rows * self.fold.cols(b));
            rest = others;
            matrix
        });
        (lines, matrices)
    }

    fn gather<T: Scalar>(&self, x: &[T], lines: &mut [T], matrices: &mut Matrices<T>) {
        for (i, image) in x.chunks_exact(self.shape_in().len()).enumerate() {
            let first = i * self.fold.out_pixels();
            self.fold.gather(image, lines, matrices, first);
        }
    }

    fn rows<'a, T>(&self, b: Irrep, matrices: &'a Matrices<T>) -> Rows<'a, T> {
        Rows {
            data: &*matrices[b.index()],
            stride: self.fold.cols(b),
        }
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
        self.blocks.init(rng, gain, params);
    }

    fn scratch_len(&self, samples: usize) -> usize {
        let rows = self.group().min(samples) * self.fold.out_pixels();
        self.fold.lines_len() + rows * self.fold.all_cols()
    }

    fn forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]) {
        self.blocks.fill_bias(params, y);
        let group = self.group();
        let xs = x.chunks(group * self.shape_in().len());
        let ys = y.chunks_mut(group * self.shape_out().len());
        for (x, y) in xs.zip(ys) {
            let samples = self.shape_in().samples(x.len());
            let (lines, mut matrices) = self.parts(scratch, samples);
            self.gather(x, lines, &mut matrices);
            for b in Irrep::ALL {
                self.blocks.forward(b, params, self.rows(b, &matrices), y);
            }
        }
    }

    fn backward(
        &self,
        params: &[T],
        x: &[T],
        _y: &[T],
        dy: &[T],
        mut dx: Option<&mut [T]>,
        dparams: &mut [T],
        scratch: &mut [T],
    ) {
        self.blocks.add_bias_gradient(dy, dparams);
        let group = self.group();
        let (in_len, out_len) = (self.shape_in().len(), self.shape_out().len());
        let xs = x.chunks(group * in_len);
        for (i, (x, dy)) in xs.zip(dy.chunks(group * out_len)).enumerate() {
            let samples = self.shape_in().samples(x.len());
            let (lines, mut matrices) = self.parts(scratch, samples);
            self.gather(x, lines, &mut matrices);
            for b in Irrep::ALL {
                let rows = self.rows(b, &matrices);
                self.blocks.add_weight_gradient(b, rows, dy, dparams);
            }
            if let Some(dx) = dx.as_deref_mut() {
                let dx = &mut dx[i * group * in_len..][..x.len()];
                self.input_gradient(params, dy, dx, lines, &mut matrices);
            }
        }
    }
}

impl R2Conv {
    fn input_gradient<T: Scalar>(
        &self,
        params: &[T],
        dy: &[T],
        dx: &mut [T],
        lines: &mut [T],
        matrices: &mut Matrices<T>,
    ) {
        for b in Irrep::ALL {
            let block = RowsMut {
                data: &mut *matrices[b.index()],
                stride: self.fold.cols(b),
            };
            self.blocks.input_gradient(b, params, dy, block);
        }
        for (i, image) in dx.chunks_exact_mut(self.shape_in().len()).enumerate() {
            let first = i * self.fold.out_pixels();
            self.fold.scatter(image, lines, matrices, first);
        }
    }
}

impl fmt::Display for R2Conv {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "R2Conv({} -> {}, {} | {} parameters)",
            self.shape_in(),
            self.shape_out(),
            self.fold.kernel(),
            self.blocks.num_params()
        )
    }
}
