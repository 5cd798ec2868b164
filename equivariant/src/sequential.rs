//! Layers one after the other.

use std::fmt;
use std::ops::Range;

use rand::Rng;

use crate::chain::Chain;
use crate::{Layer, LayerError, Scalar, Shape};

/// A chain of layers, itself a layer.
///
/// Convolutions and ReLUs that follow one another run fused, which changes no value but by rounding.
/// Its parameters are those of its layers in order. `forward` leaves every activation in
/// `scratch`, from where `backward` reads them: hand it the scratch that `forward` of the same samples
/// filled.
pub struct Sequential<T> {
    layers: Vec<Box<dyn Layer<T>>>,
    params: Vec<Range<usize>>,
    stages: Vec<Stage>,
}

/// Layers that run as one.
struct Stage {
    layers: Range<usize>,
    fused: Option<Chain>,
}

/// Fuses what can be fused.
fn stages<T: Scalar>(layers: &[Box<dyn Layer<T>>]) -> Vec<Stage> {
    let mut stages = Vec::new();
    let mut start = 0;
    while start < layers.len() {
        let (fused, len) = Chain::take(&layers[start..]).unzip();
        let end = start + len.unwrap_or(1);
        let layers = start..end;
        stages.push(Stage { layers, fused });
        start = end;
    }
    stages
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
            stages: stages(&layers),
            layers,
        })
    }

    /// Where the parameters of layer `index` lie among those of the chain.
    pub fn params_of(&self, index: usize) -> Range<usize> {
        self.params[index].clone()
    }

    /// The stages with their parameters.
    fn stages(&self) -> impl DoubleEndedIterator<Item = (&dyn Layer<T>, Range<usize>)> {
        self.stages.iter().map(|stage| {
            let Range { start, end } = stage.layers;
            let layer = match &stage.fused {
                Some(chain) => chain,
                None => self.layers[start].as_ref(),
            };
            (layer, self.params[start].start..self.params[end - 1].end)
        })
    }

    /// Lengths of the activations between the stages, per batch.
    fn between(&self, samples: usize) -> impl Iterator<Item = usize> {
        let inner = self.stages().take(self.stages.len() - 1);
        inner.map(move |(layer, _)| samples * layer.out_shape().len())
    }

    /// Lengths of the scratch of the stages that keep it.
    fn kept(&self, samples: usize) -> impl Iterator<Item = usize> {
        let kept = self.stages().filter(|(layer, _)| layer.keeps_scratch());
        kept.map(move |(layer, _)| layer.scratch_len(samples))
    }

    fn split<'a>(&self, samples: usize, scratch: &'a mut [T]) -> Parts<'a, T> {
        let (activations, rest) = scratch.split_at_mut(self.between(samples).sum());
        let (kept, rest) = rest.split_at_mut(self.kept(samples).sum());
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
        self.layers[self.layers.len() - 1].out_shape()
    }

    fn num_params(&self) -> usize {
        self.params[self.params.len() - 1].end
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
        let shared = self.stages().filter(|(layer, _)| !layer.keeps_scratch());
        let shared = shared.map(|(layer, _)| layer.scratch_len(samples)).max();
        let activations: usize = self.between(samples).sum();
        let largest = self.between(samples).max().unwrap_or(0);
        activations + self.kept(samples).sum::<usize>() + 2 * largest + shared.unwrap_or(0)
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
        for (i, (layer, range)) in self.stages().enumerate() {
            let scratch = if layer.keeps_scratch() {
                take_front(&mut kept, layer.scratch_len(samples))
            } else {
                &mut *shared
            };
            let output = match y.take_if(|_| i + 1 == self.stages.len()) {
                Some(y) => y,
                None => take_front(&mut activations, samples * layer.out_shape().len()),
            };
            layer.forward(&params[range], input, output, scratch);
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
        for (i, (layer, range)) in (0..self.stages.len()).rev().zip(self.stages().rev()) {
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
            let dy = if i + 1 == self.stages.len() {
                dy
            } else {
                &output_gradient[..out_len]
            };
            let dx = if i == 0 {
                dx.take()
            } else {
                Some(&mut input_gradient[..in_len])
            };
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
