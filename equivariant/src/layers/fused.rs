//! A fused chain as a layer.

use std::fmt;

use crate::backward_pass::BackwardPass;
use crate::conv::chain::Chain;
use crate::conv::maps::Input;
use crate::layers::layer::{Layer, Signature};
use crate::layers::scalar::Scalar;
use crate::shape::Shape;

impl Signature for Chain {
    fn in_shape(&self) -> Shape {
        Chain::in_shape(self)
    }

    fn out_shape(&self) -> Shape {
        Chain::out_shape(self)
    }

    fn num_params(&self) -> usize {
        Chain::num_params(self)
    }

    fn scratch_len(&self, samples: usize) -> usize {
        Chain::scratch_len(self, samples)
    }

    fn keeps_scratch(&self) -> bool {
        self.kept(1) > 0
    }
}

impl<T: Scalar> Layer<T> for Chain {
    fn run_forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]) {
        let samples = x.len() / Signature::in_shape(self).len();
        Chain::forward(self, params, (samples, Input::Channels(x)), y, scratch);
    }

    fn run_backward(&self, pass: BackwardPass<T>) {
        let samples = pass.x.len() / Signature::in_shape(self).len();
        Chain::backward(self, (samples, Input::Channels(pass.x)), pass);
    }
}

impl fmt::Display for Chain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shapes: Vec<String> = self.outs().map(|out| out.to_string()).collect();
        write!(f, "Chain({} -> {})", self.in_shape(), shapes.join(" -> "))
    }
}
