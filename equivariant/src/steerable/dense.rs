//! Dense form of a layer with weights: the ordinary convolution that other libraries store.

use symmetry::{FieldType, Irrep};

use crate::real::Real;
use crate::shape::Shape;
use crate::steerable::hadamard::{hadamard_transform_pixels, permuted_field_order_and_count};
use crate::steerable::irrep_weights::IrrepWeights;
use crate::steerable::taps::TapBasis;
use crate::window::SlidingWindow;

/// Ordinary convolution equal to a layer: a kernel `[C_out, C_in, size, size]` and a bias
/// `[C_out]`.
///
/// [`R2Conv::as_ordinary_conv`](crate::R2Conv::as_ordinary_conv) and
/// [`Linear::as_ordinary_conv`](crate::Linear::as_ordinary_conv) create it; a linear layer is a
/// convolution of one tap. Cross-correlation with the kernel, plus the bias, equals the layer. It
/// is meant for checks, export and import; layers never build it.
///
/// In the irrep basis the parameters are coefficients of an orthonormal basis of all steerable
/// kernels, so [`project_kernel`](OrdinaryConv::project_kernel) is both the inverse of
/// [`kernel`](OrdinaryConv::kernel) and the best approximation of a kernel that is not steerable.
#[derive(Clone, Debug)]
pub struct OrdinaryConv<'a> {
    pub(crate) layer_name: &'static str,
    pub(crate) taps: TapBasis,
    pub(crate) irrep_weights: &'a IrrepWeights,
    /// Index of the parameter of every entry of the irreps' weight matrices; `None` if the matrices
    /// lie among the parameters as they are.
    pub(crate) param_indices: Option<&'a [usize]>,
    pub(crate) window: SlidingWindow,
    pub(crate) in_shape: Shape,
    pub(crate) out_shape: Shape,
}

/// Steerable kernel that is closest to a dense kernel, with the share of the dense kernel that is
/// lost.
#[derive(Clone, Debug, PartialEq)]
pub struct ClosestSteerableKernel<T> {
    /// Parameters of the layer with the closest kernel; the biases are zero.
    pub params: Vec<T>,
    /// Share of the dense kernel that is not steerable, in [0, 1]: the Euclidean norm of the rest
    /// over that of the dense kernel.
    pub lost_share: f64,
}

impl OrdinaryConv<'_> {
    /// Returns the sliding window of the convolution: size, stride and padding.
    pub fn window(&self) -> SlidingWindow {
        self.window
    }

    /// Returns the shape of one input sample.
    pub fn in_shape(&self) -> Shape {
        self.in_shape
    }

    /// Returns the shape of one output sample.
    pub fn out_shape(&self) -> Shape {
        self.out_shape
    }

    /// Returns the shape of the kernel, `[C_out, C_in, size, size]`.
    pub fn kernel_shape(&self) -> [usize; 4] {
        let size = self.taps.kernel_size;
        [self.out_type().dim(), self.in_type().dim(), size, size]
    }

    /// Returns the dense kernel `[C_out, C_in, size, size]` of the layer with the parameters
    /// `params`, in the irrep basis.
    ///
    /// # Panics
    /// When `params` does not hold the layer's parameters.
    pub fn kernel<T: Real>(&self, params: &[T]) -> Vec<T> {
        self.check(params);
        let mut kernel = vec![T::ZERO; self.kernel_shape().iter().product()];
        self.each_coefficient(|weight, tap, c| kernel[tap] += params[weight] * T::from_f64(c));
        kernel
    }

    /// Returns the bias `[C_out]` in the irrep basis: zero except for trivial channels.
    ///
    /// # Panics
    /// As [`kernel`](OrdinaryConv::kernel).
    pub fn bias<T: Real>(&self, params: &[T]) -> Vec<T> {
        self.check(params);
        let mut bias = params[self.irrep_weights.bias_range()].to_vec();
        bias.resize(self.out_type().dim(), T::ZERO);
        bias
    }

    /// Returns the dense kernel in the regular basis, as libraries of expanded steerable kernels
    /// store it.
    ///
    /// Regular fields are in the layout of [`hadamard_transform`](crate::hadamard_transform), where
    /// a ReLU is pointwise as in every other library. A side of another type stays in the irrep
    /// basis.
    ///
    /// # Panics
    /// As [`kernel`](OrdinaryConv::kernel).
    pub fn regular_basis_kernel<T: Real>(&self, params: &[T]) -> Vec<T> {
        let mut kernel = self.kernel(params);
        self.change_basis(&mut kernel);
        kernel
    }

    /// Returns the steerable kernel that is closest to the dense kernel `kernel`, which is in the
    /// irrep basis.
    ///
    /// # Panics
    /// When `kernel` is not of the [`kernel_shape`](OrdinaryConv::kernel_shape).
    pub fn project_kernel<T: Real>(&self, kernel: &[T]) -> ClosestSteerableKernel<T> {
        let shape = self.kernel_shape();
        assert_eq!(
            kernel.len(),
            shape.iter().product::<usize>(),
            "{}: got a kernel of this many entries, expected {shape:?}",
            self.layer_name
        );
        let mut params = vec![T::ZERO; self.irrep_weights.num_params()];
        self.each_coefficient(|weight, tap, c| params[weight] += kernel[tap] * T::from_f64(c));
        let square = |v: f64| v * v;
        let total: f64 = kernel.iter().map(|k| square(k.to_f64())).sum();
        let projected = self.kernel(&params);
        let pairs = kernel.iter().zip(&projected);
        let rest: f64 = pairs.map(|(a, b)| square(a.to_f64() - b.to_f64())).sum();
        // a kernel of zeros has a residual of 0 instead of 0 / 0
        ClosestSteerableKernel { params, lost_share: (rest / total.max(f64::MIN_POSITIVE)).sqrt() }
    }

    /// Returns the steerable kernel that is closest to the dense kernel `kernel`, which is in the
    /// regular basis.
    ///
    /// # Panics
    /// As [`project_kernel`](OrdinaryConv::project_kernel).
    pub fn project_regular_basis_kernel<T: Real>(&self, kernel: &[T]) -> ClosestSteerableKernel<T> {
        // the change of basis is orthonormal and its own inverse
        let mut kernel = kernel.to_vec();
        self.change_basis(&mut kernel);
        self.project_kernel(&kernel)
    }

    fn in_type(&self) -> FieldType {
        self.in_shape.fields
    }

    fn out_type(&self) -> FieldType {
        self.out_shape.fields
    }

    fn check<T>(&self, params: &[T]) {
        let expected = self.irrep_weights.num_params();
        let got = params.len();
        assert!(got == expected, "{}: got {got} parameters, expected {expected}", self.layer_name);
    }

    /// Calls `f(parameter, kernel entry, coefficient)` for every non-zero entry of the basis
    /// kernels.
    fn each_coefficient(&self, mut f: impl FnMut(usize, usize, f64)) {
        let [_, in_dim, size, _] = self.kernel_shape();
        for b in Irrep::ALL {
            let mut weights = self.irrep_weights.weight_range(b);
            for out in self.out_type().channel_range(b) {
                for function in &self.taps.basis_functions {
                    let channels = self
                        .in_type()
                        .channel_range(self.taps.input_irrep_for_parity(b, function.parity));
                    for (channel, weight) in channels.zip(&mut weights) {
                        for &([row, col], c) in &function.tap_coefficients {
                            f(
                                self.param_indices.map_or(weight, |places| places[weight]),
                                ((out * in_dim + channel) * size + row) * size + col,
                                c,
                            );
                        }
                    }
                }
            }
        }
    }

    /// Transforms the output and the input channels of a kernel between the irrep basis and the
    /// regular basis.
    fn change_basis<T: Real>(&self, kernel: &mut [T]) {
        let [_, in_dim, size, _] = self.kernel_shape();
        for per_output in kernel.chunks_exact_mut((in_dim * size * size).max(1)) {
            change_channels(self.in_type(), per_output, size * size);
        }
        change_channels(self.out_type(), kernel, in_dim * size * size);
    }
}

/// Transforms the first axis of `[dim, inner]` values, the channels, between the irrep basis and
/// the regular basis.
fn change_channels<T: Real>(fields: FieldType, values: &mut [T], inner: usize) {
    if let Some((order, n)) = permuted_field_order_and_count(fields) {
        // the transform treats [order, n, inner] as one pixel of n * inner fields
        hadamard_transform_pixels(order, n * inner, values);
    }
}
