//! The dense kernel of a steerable convolution: the slow twin of the fold.

use std::f64::consts::FRAC_1_SQRT_2;

use symmetry::{FieldType, Irrep};

use crate::hadamard::hadamard;
use crate::{Layer, LayerError, R2Conv, Scalar};

impl R2Conv {
    /// The dense kernel `[C_out, C_in, size, size]` in the irrep basis.
    ///
    /// An ordinary cross-correlation with it, plus the bias, is this layer. It is meant for
    /// checks and for export; the layer itself never builds it.
    ///
    /// # Panics
    /// When `params` does not hold the layer's parameters.
    pub fn expanded_kernel<T: Scalar>(&self, params: &[T]) -> Vec<T> {
        assert_eq!(params.len(), Layer::<T>::num_params(self));
        let fold = self.fold();
        let k = fold.kernel().size;
        let mut kernel = vec![T::ZERO; self.out_type().dim() * fold.in_type().dim() * k * k];
        for b in Irrep::ALL {
            let weights = &params[self.blocks().weights(b)];
            let rows = weights.chunks_exact(fold.cols(b).max(1));
            for (out, row) in self.out_type().range(b).zip(rows) {
                for parity in Irrep::ALL {
                    self.expand_row(
                        b,
                        parity,
                        row,
                        &mut kernel[out * fold.in_type().dim() * k * k..],
                    );
                }
            }
        }
        kernel
    }

    /// Adds what the folded taps of one parity contribute to the kernel of one output channel.
    fn expand_row<T: Scalar>(&self, b: Irrep, parity: Irrep, row: &[T], kernel: &mut [T]) {
        let fold = self.fold();
        let k = fold.kernel().size;
        let (x_odd, y_odd) = (parity.index() & 1, parity.index() >> 1);
        for i in 0..fold.axis_taps(y_odd) {
            for j in 0..fold.axis_taps(x_odd) {
                let column = fold.column(b, (y_odd, i), (x_odd, j));
                for (c, channel) in fold.in_type().range(b * parity).enumerate() {
                    for (ty, y_part) in tap_parts(k, y_odd, i) {
                        for (tx, x_part) in tap_parts(k, x_odd, j) {
                            let part = T::from_f64(y_part * x_part);
                            kernel[(channel * k + ty) * k + tx] += row[column + c] * part;
                        }
                    }
                }
            }
        }
    }

    /// The dense kernel `[C_out, C_in, size, size]` in the regular basis.
    ///
    /// Regular fields are expanded in the layout of [`hadamard`](crate::hadamard()); trivial channels stay as
    /// they are. It is the kernel that a library of expanded steerable kernels would hold.
    ///
    /// # Errors
    /// When one of the types is neither regular nor trivial.
    ///
    /// # Panics
    /// When `params` does not hold the layer's parameters.
    pub fn expanded_regular_kernel<T: Scalar>(&self, params: &[T]) -> Result<Vec<T>, LayerError> {
        let (in_type, out_type) = (self.fold().in_type(), self.out_type());
        for got in [in_type, out_type] {
            if got.regular_fields().is_none() && !got.is_trivial() {
                return Err(LayerError::Type {
                    layer: "R2Conv",
                    got,
                    expected: "regular fields only or trivial channels only",
                });
            }
        }
        let mut kernel = self.expanded_kernel(params);
        let taps = self.fold().kernel().size.pow(2);
        for per_output in kernel.chunks_exact_mut(in_type.dim() * taps) {
            to_regular(in_type, per_output, taps);
        }
        to_regular(out_type, &mut kernel, in_type.dim() * taps);
        Ok(kernel)
    }
}

/// The taps of an axis that make up a folded tap, with their coefficients.
fn tap_parts(k: usize, odd: usize, i: usize) -> Vec<(usize, f64)> {
    let mirrored = k - 1 - i;
    if mirrored == i {
        return vec![(i, 1.0)];
    }
    let sign = if odd == 1 { -1.0 } else { 1.0 };
    vec![(i, FRAC_1_SQRT_2), (mirrored, sign * FRAC_1_SQRT_2)]
}

/// Transforms the first axis, the channels, of `[dim, inner]` values.
fn to_regular<T: Scalar>(fields: FieldType, values: &mut [T], inner: usize) {
    if fields.regular_fields().is_none() {
        return;
    }
    for i in 0..inner {
        let mut channels: Vec<T> = values[i..].iter().step_by(inner).copied().collect();
        hadamard(&mut channels);
        for (value, channel) in values[i..].iter_mut().step_by(inner).zip(channels) {
            *value = channel;
        }
    }
}
