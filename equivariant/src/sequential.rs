//! Layers one after the other.

use std::fmt;
use std::ops::Range;

use rand::Rng;

use crate::{Layer, LayerError, Scalar, Shape};

/// A chain of layers, itself a layer.
///
/// Its parameters are those of its layers in order. `forward` leaves every activation in
/// `scratch`, from where `backward` reads them: hand it the scratch that `forward` of the same samples
/// filled.
pub struct Sequential<T> {
    layers: Vec<Box<dyn Layer<T>>>,
    params: Vec<Range<usize>>,
}

impl<T: Scalar> Sequential<T> {
    /// Chains the layers.
    ///
    /// # Errors
    /// When there are none, or neighbours disagree about the shape between them.
    pub fn new(layers: Vec<Box<dyn Layer<T>>>) -> Result<Sequential<T>, LayerError> {
        if layers.is_empty() {
            return Err(LayerError::Empty);
        }
        for (previous, pair) in layers.windows(2).enumerate() {
            let (gives, takes) = (pair[0].out_shape(), pair[1].in_shape());
            if gives != takes {
                return Err(LayerError::Mismatch {
                    index: previous + 1,
                    takes,
                    gives,
                });
            }
        }
        let mut end = 0;
        let params = layers.iter().map(|layer| {
            let start = end;
            end += layer.num_params();
            start..end
        });
        Ok(Sequential {
            params: params.collect(),
            layers,
        })
    }

    /// Where the parameters of layer `index` lie among those of the chain.
    pub fn params_of(&self, index: usize) -> Range<usize> {
        self.params[index].clone()
    }

    fn last(&self) -> usize {
        self.layers.len() - 1
    }

    /// Lengths of the activations between the layers, per batch.
    fn between(&self, samples: usize) -> impl Iterator<Item = usize> {
        let inner = &self.layers[..self.last()];
        inner
            .iter()
            .map(move |layer| samples * layer.out_shape().len())
    }

    fn split<'a>(&self, samples: usize, scratch: &'a mut [T]) -> Parts<'a, T> {
        let (activations, rest) = scratch.split_at_mut(self.between(samples).sum());
        let kept = self.layers.iter().filter(|layer| layer.keeps_scratch());
        let kept = kept.map(|layer| layer.scratch_len(samples)).sum();
        let (kept, rest) = rest.split_at_mut(kept);
        let largest = self.between(samples).max().unwrap_or(0);
        let (gradient, rest) = rest.split_at_mut(largest);
        let (next_gradient, shared) = rest.split_at_mut(largest);
        Parts {
            activations,
            kept,
            gradients: [gradient, next_gradient],
            shared,
        }
    }
}

/// The parts of a chain's scratch.
struct Parts<'a, T> {
    activations: &'a mut [T],
    kept: &'a mut [T],
    gradients: [&'a mut [T]; 2],
    shared: &'a mut [T],
}

impl<T: Scalar> Layer<T> for Sequential<T> {
    fn in_shape(&self) -> Shape {
        self.layers[0].in_shape()
    }

    fn out_shape(&self) -> Shape {
        self.layers[self.last()].out_shape()
    }

    fn num_params(&self) -> usize {
        self.params[self.last()].end
    }

    fn layers(&self) -> &[Box<dyn Layer<T>>] {
        &self.layers
    }

    fn init_scaled(&self, rng: &mut dyn Rng, gain: f64, params: &mut [T]) {
        let scaled = self.layers.iter().rposition(|layer| layer.num_params() > 0);
        for (i, (layer, range)) in self.layers.iter().zip(&self.params).enumerate() {
            let params = &mut params[range.clone()];
            match scaled {
                Some(last) if last == i => layer.init_scaled(rng, gain, params),
                _ => layer.init(rng, params),
            }
        }
    }

    fn scratch_len(&self, samples: usize) -> usize {
        let len = |layer: &dyn Layer<T>| layer.scratch_len(samples);
        let (keeping, sharing): (Vec<_>, Vec<_>) =
            self.layers.iter().partition(|layer| layer.keeps_scratch());
        let kept: usize = keeping.into_iter().map(|layer| len(layer.as_ref())).sum();
        let shared = sharing.into_iter().map(|layer| len(layer.as_ref())).max();
        let largest = self.between(samples).max().unwrap_or(0);
        self.between(samples).sum::<usize>() + kept + 2 * largest + shared.unwrap_or(0)
    }

    fn keeps_scratch(&self) -> bool {
        true
    }

    fn forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]) {
        let samples = self.in_shape().samples(x.len());
        let Parts {
            mut activations,
            mut kept,
            shared,
            ..
        } = self.split(samples, scratch);
        let mut y = Some(y);
        let mut input = x;
        for (i, (layer, range)) in self.layers.iter().zip(&self.params).enumerate() {
            let scratch = if layer.keeps_scratch() {
                take_front(&mut kept, layer.scratch_len(samples))
            } else {
                &mut *shared
            };
            let output = match y.take_if(|_| i == self.last()) {
                Some(y) => y,
                None => take_front(&mut activations, samples * layer.out_shape().len()),
            };
            layer.forward(&params[range.clone()], input, output, scratch);
            input = output;
        }
    }

    fn backward(
        &self,
        params: &[T],
        x: &[T],
        y: &[T],
        dy: &[T],
        mut dx: Option<&mut [T]>,
        dparams: &mut [T],
        scratch: &mut [T],
    ) {
        let samples = self.in_shape().samples(x.len());
        let Parts {
            activations,
            mut kept,
            gradients: [mut output_gradient, mut input_gradient],
            shared,
        } = self.split(samples, scratch);
        let mut activations = &*activations;
        let mut output = y;
        for (i, layer) in self.layers.iter().enumerate().rev() {
            let (in_len, out_len) = (
                samples * layer.in_shape().len(),
                samples * layer.out_shape().len(),
            );
            let input = if i == 0 {
                x
            } else {
                take_back(&mut activations, in_len)
            };
            let scratch = if layer.keeps_scratch() {
                take_back_mut(&mut kept, layer.scratch_len(samples))
            } else {
                &mut *shared
            };
            let dy = if i == self.last() {
                dy
            } else {
                &output_gradient[..out_len]
            };
            let dx = if i == 0 {
                dx.take()
            } else {
                Some(&mut input_gradient[..in_len])
            };
            let range = self.params[i].clone();
            let dparams = &mut dparams[range.clone()];
            layer.backward(&params[range], input, output, dy, dx, dparams, scratch);
            std::mem::swap(&mut output_gradient, &mut input_gradient);
            output = input;
        }
    }
}

fn take_front<'a, T>(rest: &mut &'a mut [T], len: usize) -> &'a mut [T] {
    let (front, back) = std::mem::take(rest).split_at_mut(len);
    *rest = back;
    front
}

fn take_back<'a, T>(rest: &mut &'a [T], len: usize) -> &'a [T] {
    let (front, back) = rest.split_at(rest.len() - len);
    *rest = front;
    back
}

fn take_back_mut<'a, T>(rest: &mut &'a mut [T], len: usize) -> &'a mut [T] {
    let at = rest.len() - len;
    let (front, back) = std::mem::take(rest).split_at_mut(at);
    *rest = front;
    back
}

impl<T: Scalar> fmt::Display for Sequential<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let layers: Vec<String> = self.layers.iter().map(|layer| layer.to_string()).collect();
        write!(f, "Sequential({})", layers.join(", "))
    }
}

impl<T: Scalar> fmt::Debug for Sequential<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Sequential")
            .field("layers", &self.layers.len())
            .field("num_params", &self.num_params())
            .finish()
    }
}
