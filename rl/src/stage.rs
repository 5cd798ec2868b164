//! A layer with the buffers of its passes.

use std::ops::Range;

use equivariant::{Layer, Scalar, Scratch, unit_sums};

/// Buffers of one layer for up to a fixed number of samples: input and output with their gradients,
/// and the layer's scratch.
#[derive(Clone, Debug)]
pub(crate) struct Stage<T> {
    pub x: Vec<T>,
    pub y: Vec<T>,
    pub dx: Vec<T>,
    pub dy: Vec<T>,
    scratch: Scratch<T>,
}

impl<T: Scalar> Stage<T> {
    pub fn new(layer: &impl Layer<T>, samples: usize) -> Self {
        let zeros = |len| vec![T::ZERO; len];
        let (input, output) = (
            samples * layer.in_shape().len(),
            samples * layer.out_shape().len(),
        );
        Self {
            x: zeros(input),
            y: zeros(output),
            dx: zeros(input),
            dy: zeros(output),
            scratch: layer.scratch(samples),
        }
    }

    /// Runs the first n samples.
    pub fn forward(&mut self, layer: &impl Layer<T>, params: &[T], n: usize) {
        let (x, y) = (n * layer.in_shape().len(), n * layer.out_shape().len());
        layer.forward(params, &self.x[..x], &mut self.y[..y], &mut self.scratch);
    }

    /// Sums of what each unit puts out for the first n samples, a list for each ReLU.
    pub fn unit_sums(&self, layer: &impl Layer<T>, params: &[T], n: usize) -> Vec<Vec<f64>> {
        unit_sums(layer, params, &self.x[..n * layer.in_shape().len()])
    }

    /// Adds the gradient in the parameters `range`, and writes that in the input if it is wanted.
    pub fn backward(
        &mut self,
        layer: &impl Layer<T>,
        (params, range): (&[T], Range<usize>),
        n: usize,
        dparams: &mut [T],
        input_too: bool,
    ) {
        let (input, output) = (n * layer.in_shape().len(), n * layer.out_shape().len());
        let dx = input_too.then_some(&mut self.dx[..input]);
        let (x, y, dy) = (&self.x[..input], &self.y[..output], &self.dy[..output]);
        let (params, dparams) = (&params[range.clone()], &mut dparams[range]);
        layer.backward(params, x, y, dy, dx, dparams, &mut self.scratch);
    }
}
