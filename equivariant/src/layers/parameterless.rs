//! Layers without parameters.

use crate::backward_pass::BackwardPass;
use crate::layers::layer::{Layer, Signature};
use crate::layers::scalar::Scalar;

/// A map without parameters, which is a [`Layer`] in either precision.
pub(crate) trait Parameterless: Signature {
    /// What [`run_forward`](Layer::run_forward) does.
    fn apply<T: Scalar>(&self, x: &[T], y: &mut [T], scratch: &mut [T]);

    /// What [`run_backward`](Layer::run_backward) does where the gradient in the input is asked
    /// for.
    fn pull_back<T: Scalar>(&self, x: &[T], y: &[T], dy: &[T], dx: &mut [T], scratch: &mut [T]);
}

impl<T: Scalar, L: Parameterless> Layer<T> for L {
    fn run_forward(&self, _params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]) {
        self.apply(x, y, scratch);
    }

    fn run_backward(&self, pass: BackwardPass<T>) {
        if let Some(dx) = pass.dx {
            self.pull_back(pass.x, pass.y, pass.dy, dx, pass.scratch);
        }
    }
}
