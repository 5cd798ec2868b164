//! Layer traits of steerable convolutions.

use std::fmt;

use rand::Rng;
use symmetry::{FieldType, Group};

use crate::conv::dispatch;
use crate::conv::maps::{Input, Maps, MapsMut};
use crate::conv::operands::{Backward, Forward, Output};
pub use crate::conv::r2_conv::R2Conv;
use crate::error::LayerError;
use crate::layers::check::Example;
use crate::layers::layer::{Layer, LayerKind, Scalar, Signature};
use crate::scratch::BackwardPass;
use crate::shape::Shape;
use crate::window::Kernel;

impl Signature for R2Conv {
    fn in_shape(&self) -> Shape {
        self.image()
    }

    fn out_shape(&self) -> Shape {
        self.out
    }

    fn num_params(&self) -> usize {
        self.blocks.num_params()
    }

    fn scratch_len(&self, samples: usize) -> usize {
        dispatch::scratch_len(self, samples, false)
    }
}

impl<T: Scalar> Layer<T> for R2Conv {
    fn kind(&self) -> LayerKind<'_, T> {
        LayerKind::R2Conv(self)
    }

    fn draw(&self, rng: &mut dyn Rng, gain: f64, params: &mut [T]) {
        // weights are drawn block by block and then moved to the interleaved order of the kernels
        let mut drawn = params.to_vec();
        self.blocks.init(rng, gain, &mut drawn);
        params.copy_from_slice(&drawn);
        for (&place, &weight) in self.weights.places().iter().zip(&drawn) {
            params[place] = weight;
        }
    }

    fn run_forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]) {
        let pass = Forward {
            conv: self,
            samples: x.len() / self.image().len(),
            params,
            x: Input::Channels(x),
            to: Output { lines: 0..self.out.height, y: MapsMut::Channels(y), masks: None },
            scratch,
        };
        pass.run_on_threads();
    }

    fn run_backward(&self, pass: BackwardPass<T>) {
        T::backward(Backward {
            conv: self,
            samples: pass.x.len() / self.image().len(),
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
        let (from, to, window) = (self.image(), self.out, self.patches.kernel());
        let parameters = self.blocks.num_params();
        write!(f, "R2Conv({from} -> {to}, {window} | {parameters} parameters)")
    }
}

/// Returns examples for the tests of all layers.
pub(super) fn examples<T: Scalar>(group: Group) -> Result<Vec<Example<T>>, LayerError> {
    let conv = |from, to, [size, stride, padding]: [usize; 3], image| {
        R2Conv::new(from, to, Kernel::new(size, stride, padding), image)
    };
    let regular = |n| group.regular(n);
    let mixed = FieldType::new(group, [2, 1, 3, 0]);
    let lacking = FieldType::new(group, [1, 2, 0, 2]);
    let first = conv(group.trivial(6), regular(4), [4, 2, 1], [6, 8])?;
    let even = conv(regular(8), regular(2), [2, 2, 0], [4, 6])?;
    let flatten = R2Conv::flatten(Shape::image(3, 3, regular(2)), mixed)?;
    Ok(vec![
        Example::rounded("4x4/2", first),
        Example::rounded("3x3", conv(regular(2), regular(3), [3, 1, 0], [3, 3])?),
        Example::rounded("3x3/2", conv(mixed, lacking, [3, 2, 1], [5, 7])?),
        Example::rounded("5x5", conv(regular(1), mixed, [5, 1, 2], [4, 3])?),
        Example::rounded("2x2", even),
        Example::rounded("1x1", conv(mixed, mixed, [1, 1, 0], [2, 3])?),
        Example::rounded("flatten", flatten),
    ])
}
