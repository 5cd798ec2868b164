//! Chains of layers.

use std::fmt;
use std::ops::Range;

use rand::Rng;

use crate::conv::maps::ConvInput;
use crate::error::LayerError;
use crate::layers::fused_chain::FusedChain;
use crate::layers::layer::{
    Layer, LayerKind, LayerSignature, Scalar, check_backward, check_forward, count_samples,
    hash_of, mark_scratch_filled, take_filled_scratch, take_unfilled_scratch,
};
use crate::scratch::{
    BackwardArgs, Scratch, round_up_to_cache_line, take_back_padded, take_front, take_front_padded,
};
use crate::shape::Shape;

/// Chain of layers, itself a layer.
///
/// Consecutive convolutions, ReLUs and max-poolings run fused, which changes values by rounding
/// only. Its parameters are those of its layers in order. `forward` saves every activation in
/// `scratch`, where `backward` reads them, so pass the scratch that `forward` of the same samples
/// filled.
pub struct Sequential<T> {
    layers: Vec<Box<dyn Layer<T>>>,
    params: Vec<Range<usize>>,
    stages: Vec<Stage>,
    scratch_key: u64,
}

/// Consecutive layers of a chain that run as one fused operation, or a single layer.
struct Stage {
    layers: Range<usize>,
    /// Fused form of the layers, if they begin with a convolution.
    fused: Option<FusedChain>,
}

/// Returns the ranges of the parameters of layers whose parameters lie one after another.
pub(super) fn param_ranges<T: Scalar>(layers: &[Box<dyn Layer<T>>]) -> Vec<Range<usize>> {
    let mut end = 0;
    let ranges = layers.iter().map(|layer| {
        let start = end;
        end += layer.num_params();
        start..end
    });
    ranges.collect()
}

/// Groups the layers of a chain into stages that run as one: a convolution takes all later layers
/// that can be fused with it.
fn stages<T: Scalar>(layers: &[Box<dyn Layer<T>>]) -> Vec<Stage> {
    let mut stages: Vec<Stage> = Vec::new();
    for (i, layer) in layers.iter().enumerate() {
        let kind = layer.kind();
        if let Some(last) = stages.last_mut()
            && let Some(chain) = &mut last.fused
            && try_fuse(chain, &kind)
        {
            last.layers.end = i + 1;
            continue;
        }
        let fused = match kind {
            LayerKind::R2Conv(conv) => Some(FusedChain::new(conv)),
            _ => None,
        };
        let range = i..i + 1;
        stages.push(Stage { layers: range, fused });
    }
    stages
}

/// Appends a layer to a fused chain and returns `true`, or returns `false` if the two cannot be
/// fused.
fn try_fuse<T: Scalar>(chain: &mut FusedChain, kind: &LayerKind<'_, T>) -> bool {
    match kind {
        LayerKind::R2Conv(conv) => chain.try_append_conv(conv),
        LayerKind::Relu => chain.try_append_relu(),
        LayerKind::MaxPool(kernel) => chain.try_append_max_pool(*kernel),
        _ => false,
    }
}

impl<T: Scalar> Sequential<T> {
    /// Creates a chain of layers, in which each takes the output of the one before.
    ///
    /// # Errors
    /// When `layers` is empty, or neighbours disagree about the shape between them.
    pub fn new(layers: Vec<Box<dyn Layer<T>>>) -> Result<Sequential<T>, LayerError> {
        if layers.is_empty() {
            return Err(LayerError::InvalidSetting {
                layer: "Sequential",
                setting: "number of layers",
                got: "0".to_owned(),
                expected: "at least 1",
            });
        }
        for (previous, pair) in layers.windows(2).enumerate() {
            let (gives, takes) = (pair[0].out_shape(), pair[1].in_shape());
            if gives != takes {
                return Err(LayerError::ShapeMismatch { index: previous + 1, takes, gives });
            }
        }
        let printed: Vec<String> = layers.iter().map(|layer| layer.to_string()).collect();
        Ok(Sequential {
            params: param_ranges(&layers),
            stages: stages(&layers),
            scratch_key: hash_of(printed),
            layers,
        })
    }

    /// Returns the layers of the chain, in order.
    pub fn layers(&self) -> &[Box<dyn Layer<T>>] {
        &self.layers
    }

    /// Returns the range of the parameters of layer `index` among those of the chain.
    pub fn param_range(&self, index: usize) -> Range<usize> {
        self.params[index].clone()
    }

    /// Iterates over the chain's stages, each as one layer with the range of its parameters.
    fn stages(&self) -> impl DoubleEndedIterator<Item = (&dyn Layer<T>, Range<usize>)> + Clone {
        self.stages.iter().map(|stage| {
            let Range { start, end } = stage.layers;
            let layer = match &stage.fused {
                Some(chain) => chain,
                None => self.layers[start].as_ref(),
            };
            (layer, self.params[start].start..self.params[end - 1].end)
        })
    }

    /// Runs [`forward`](Layer::forward) on images `[N, H, W, C]` of bytes; the result is bitwise
    /// equal to that on the numbers that [`pixel_byte_to_float`](crate::pixel_byte_to_float) makes
    /// of the bytes.
    ///
    /// Bytes are converted where they are read, so the converted image is never stored.
    ///
    /// # Panics
    /// As `forward`, and when the first layer is no [`R2Conv`](crate::R2Conv) of trivial channels.
    pub fn forward_from_bytes(
        &self,
        params: &[T],
        pictures: &[u8],
        y: &mut [T],
        scratch: &mut Scratch<T>,
    ) {
        self.check_bytes();
        let samples = count_samples(self, "pictures", pictures.len());
        check_forward(self, samples, [params.len(), y.len()]);
        let x = ConvInput::Bytes(pictures);
        self.forward_from_input(
            params,
            samples,
            x,
            y,
            take_unfilled_scratch(self, samples, scratch),
        );
        mark_scratch_filled(self, samples, scratch);
    }

    /// Runs the backward pass of [`forward_from_bytes`](Sequential::forward_from_bytes); the result
    /// is bitwise equal to that of [`backward`](Layer::backward). Bytes have no gradient.
    ///
    /// # Panics
    /// As `forward_from_bytes` and `backward`.
    pub fn backward_from_bytes(
        &self,
        params: &[T],
        pictures: &[u8],
        [y, dy]: [&[T]; 2],
        dparams: &mut [T],
        scratch: &mut Scratch<T>,
    ) {
        self.check_bytes();
        let samples = count_samples(self, "pictures", pictures.len());
        let lens = [params.len(), y.len(), dy.len(), dparams.len()];
        check_backward(self, samples, lens);
        let args = BackwardArgs {
            params,
            x: &[],
            y,
            dy,
            dx: None,
            dparams,
            scratch: take_filled_scratch(self, samples, scratch),
        };
        self.backward_to_input(samples, ConvInput::Bytes(pictures), args);
    }

    /// Panics unless the first layer is a convolution that reads bytes.
    fn check_bytes(&self) {
        assert!(
            self.stages[0].fused.is_some() && self.in_shape().fields.is_trivial(),
            "{self}: got bytes, expected numbers, or a first layer that is a convolution of \
             trivial channels"
        );
    }

    /// Runs the forward passes of the chain's stages one after the other; `x` holds channels or
    /// bytes.
    fn forward_from_input(
        &self,
        params: &[T],
        samples: usize,
        x: ConvInput<T>,
        y: &mut [T],
        scratch: &mut [T],
    ) {
        let mut parts = self.split_scratch(samples, scratch);
        let mut y = Some(y);
        let mut input = x;
        for (i, (layer, range)) in self.stages().enumerate() {
            let layer_scratch = if layer.backward_reads_scratch() {
                take_front_padded(&mut parts.kept, layer.scratch_len(samples))
            } else {
                &mut parts.shared[..layer.scratch_len(samples)]
            };
            // only the last stage writes to y; the others write activations, which the backward
            // pass reads
            let output = match y.take_if(|_| i + 1 == self.stages.len()) {
                Some(y) => y,
                None => {
                    take_front_padded(&mut parts.activations, samples * layer.out_shape().len())
                }
            };
            match (input, &self.stages[i].fused) {
                (ConvInput::Channels(channels), _) => {
                    layer.run_forward(&params[range], channels, output, layer_scratch)
                }
                (entry, Some(chain)) => {
                    chain.forward_from_input(&params[range], samples, entry, output, layer_scratch)
                }
                (_, None) => unreachable!("bytes are for chains"),
            }
            input = ConvInput::Channels(output);
        }
    }

    /// Runs the backward passes of the chain's stages in reverse order; `x` replaces `args.x` if it
    /// holds bytes.
    fn backward_to_input(&self, samples: usize, x: ConvInput<T>, args: BackwardArgs<T>) {
        let mut parts = self.split_scratch(samples, args.scratch);
        let mut dx = args.dx;
        let [mut output_gradient, mut input_gradient] = parts.gradients;
        let mut activations = parts.activations;
        let mut output = args.y;
        for (i, (layer, range)) in (0..self.stages.len()).rev().zip(self.stages().rev()) {
            let (in_len, out_len) = (samples * layer.in_shape().len(), output.len());
            let (input, dx) = match i {
                0 => (args.x, dx.take()),
                _ => {
                    let input = &*take_back_padded(&mut activations, in_len);
                    (input, Some(&mut input_gradient[..in_len]))
                }
            };
            let args = BackwardArgs {
                params: &args.params[range.clone()],
                x: input,
                y: output,
                dy: if i + 1 == self.stages.len() { args.dy } else { &output_gradient[..out_len] },
                dx,
                dparams: &mut args.dparams[range],
                scratch: if layer.backward_reads_scratch() {
                    take_back_padded(&mut parts.kept, layer.scratch_len(samples))
                } else {
                    &mut parts.shared[..layer.scratch_len(samples)]
                },
            };
            match (i, x, &self.stages[i].fused) {
                (0, ConvInput::Bytes(_), Some(chain)) => chain.backward_to_input(samples, x, args),
                _ => layer.run_backward(args),
            }
            // the input gradient of this stage is the output gradient of the stage before it
            std::mem::swap(&mut output_gradient, &mut input_gradient);
            output = input;
        }
    }

    /// Divides a chain's scratch memory for `samples` samples into its parts.
    fn split_scratch<'a>(&self, samples: usize, scratch: &'a mut [T]) -> ScratchParts<'a, T> {
        let sizes = self.scratch_sizes(samples);
        let mut rest = scratch;
        ScratchParts {
            activations: take_front(&mut rest, sizes.activations),
            kept: take_front(&mut rest, sizes.kept),
            gradients: [(); 2].map(|()| take_front(&mut rest, sizes.gradient)),
            shared: rest,
        }
    }

    /// Returns the lengths of the parts of a chain's scratch memory for `samples` samples.
    fn scratch_sizes(&self, samples: usize) -> ScratchSizes {
        let inner = self.stages().take(self.stages.len() - 1);
        let activations =
            inner.map(|(layer, _)| round_up_to_cache_line(samples * layer.out_shape().len()));
        let scratch = |kept| {
            let layers = self.stages().map(|(layer, _)| layer);
            let chosen = layers.filter(move |layer| layer.backward_reads_scratch() == kept);
            chosen.map(move |layer| round_up_to_cache_line(layer.scratch_len(samples)))
        };
        ScratchSizes {
            activations: activations.clone().sum(),
            kept: scratch(true).sum(),
            gradient: activations.max().unwrap_or(0),
            shared: scratch(false).max().unwrap_or(0),
        }
    }
}

/// Lengths, in values, of the parts of a chain's scratch memory.
struct ScratchSizes {
    /// Total length of the outputs of all stages but the last.
    activations: usize,
    /// Total length of the scratch memory that stages keep from the forward to the backward pass.
    kept: usize,
    /// Length of each of two buffers for gradients of activations.
    gradient: usize,
    /// Length of the scratch memory that stages use in turn if they keep nothing for the backward
    /// pass.
    shared: usize,
}

struct ScratchParts<'a, T> {
    activations: &'a mut [T],
    kept: &'a mut [T],
    gradients: [&'a mut [T]; 2],
    shared: &'a mut [T],
}

impl<T: Scalar> LayerSignature for Sequential<T> {
    fn in_shape(&self) -> Shape {
        self.layers[0].in_shape()
    }

    fn out_shape(&self) -> Shape {
        self.layers[self.layers.len() - 1].out_shape()
    }

    fn num_params(&self) -> usize {
        self.params[self.params.len() - 1].end
    }

    fn scratch_len(&self, samples: usize) -> usize {
        let sizes = self.scratch_sizes(samples);
        sizes.activations + sizes.kept + 2 * sizes.gradient + sizes.shared
    }

    fn backward_reads_scratch(&self) -> bool {
        true
    }

    fn scratch_key(&self) -> u64 {
        self.scratch_key
    }
}

impl<T: Scalar> Layer<T> for Sequential<T> {
    fn kind(&self) -> LayerKind<'_, T> {
        LayerKind::Sequential(&self.layers)
    }

    fn run_init(&self, rng: &mut dyn Rng, gain: f64, params: &mut [T]) {
        // layers without parameters, such as a ReLU at the end, do not use up the gain
        let scaled = self.layers.iter().rposition(|layer| layer.num_params() > 0);
        for (i, (layer, range)) in self.layers.iter().zip(&self.params).enumerate() {
            let params = &mut params[range.clone()];
            match scaled {
                Some(last) if last == i => layer.init_with_gain(rng, gain, params),
                _ => layer.init(rng, params),
            }
        }
    }

    fn run_forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]) {
        let samples = x.len() / self.in_shape().len();
        self.forward_from_input(params, samples, ConvInput::Channels(x), y, scratch);
    }

    fn run_backward(&self, args: BackwardArgs<T>) {
        let samples = args.x.len() / self.in_shape().len();
        self.backward_to_input(samples, ConvInput::Channels(args.x), args);
    }
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
