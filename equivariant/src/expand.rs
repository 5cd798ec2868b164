//! The dense kernel of a steerable convolution: the slow twin of the fold.

use symmetry::{FieldType, Irrep};

use crate::hadamard::hadamard;
use crate::taps::Taps;
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
        let taps = self.fold().taps();
        let per_output = taps.in_type().dim() * taps.size() * taps.size();
        let mut kernel = vec![T::ZERO; self.out_type().dim() * per_output];
        for b in Irrep::ALL {
            let weights = &params[self.blocks().weights(b)];
            let rows = weights.chunks_exact(taps.cols(b).max(1));
            for (out, row) in self.out_type().range(b).zip(rows) {
                expand_row(taps, b, row, &mut kernel[out * per_output..][..per_output]);
            }
        }
        kernel
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

/// Writes the kernel `[C_in, size, size]` of one output channel of irrep b.
fn expand_row<T: Scalar>(taps: &Taps, b: Irrep, row: &[T], kernel: &mut [T]) {
    let (size, mut weights) = (taps.size(), row.iter());
    for function in taps.functions() {
        let channels = taps.in_type().range(taps.input(b, function.parity));
        for (channel, &weight) in channels.zip(&mut weights) {
            for &([ty, tx], c) in &function.parts {
                kernel[(channel * size + ty) * size + tx] += weight * T::from_f64(c);
            }
        }
    }
}

/// Transforms the first axis, the channels, of `[dim, inner]` values.
fn to_regular<T: Scalar>(fields: FieldType, values: &mut [T], inner: usize) {
    if fields.regular_fields().is_none() {
        return;
    }
    for i in 0..inner {
        let mut channels: Vec<T> = values[i..].iter().step_by(inner).copied().collect();
        hadamard(fields.group(), &mut channels);
        for (value, channel) in values[i..].iter_mut().step_by(inner).zip(channels) {
            *value = channel;
        }
    }
}
