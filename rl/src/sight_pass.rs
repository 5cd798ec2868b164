//! An image encoder with the buffers of its passes.

use equivariant::{Layer, Scalar, Scratch, Sequential, Signature, level, unit_sums};

/// Buffers for up to a fixed number of pictures: they, the output with its gradient, and the
/// encoder's scratch.
#[derive(Clone, Debug)]
pub(crate) struct SightPass<T> {
    /// `[N, H, W, C]`, bytes.
    pub pictures: Vec<u8>,
    pub y: Vec<T>,
    pub dy: Vec<T>,
    scratch: Scratch<T>,
}

impl<T: Scalar> SightPass<T> {
    pub fn new(encoder: &Sequential<T>, samples: usize) -> Self {
        let output = samples * encoder.out_shape().len();
        Self {
            pictures: vec![0; samples * encoder.in_shape().len()],
            y: vec![T::ZERO; output],
            dy: vec![T::ZERO; output],
            scratch: encoder.scratch(samples),
        }
    }

    /// Runs the first n pictures.
    pub fn forward(&mut self, encoder: &Sequential<T>, params: &[T], n: usize) {
        let (x, y) = (n * encoder.in_shape().len(), n * encoder.out_shape().len());
        let (pictures, y) = (&self.pictures[..x], &mut self.y[..y]);
        encoder.forward_bytes(params, pictures, y, &mut self.scratch);
    }

    /// Sums of what each unit puts out for the first n pictures, a list for each ReLU.
    pub fn unit_sums(&self, encoder: &Sequential<T>, params: &[T], n: usize) -> Vec<Vec<f64>> {
        let pictures = &self.pictures[..n * encoder.in_shape().len()];
        let x: Vec<T> = pictures.iter().map(|&byte| level(byte)).collect();
        unit_sums(encoder, params, &x)
    }

    /// Adds the gradient in the parameters to `dparams`, from that in the output.
    pub fn backward(&mut self, encoder: &Sequential<T>, params: &[T], n: usize, dparams: &mut [T]) {
        let (x, y) = (n * encoder.in_shape().len(), n * encoder.out_shape().len());
        let outputs = [&self.y[..y], &self.dy[..y]];
        encoder.backward_bytes(
            params,
            &self.pictures[..x],
            outputs,
            dparams,
            &mut self.scratch,
        );
    }
}
