//! Layers one after the other.

use std::fmt;
use std::ops::Range;

use rand::Rng;

use crate::conv::chain::Chain;
use crate::conv::maps::Input;
use crate::error::LayerError;
use crate::layers::layer::{
    Layer, LayerKind, Scalar, Signature, check_backward, check_forward, empty, fill, filled,
    hash_of, samples,
};
use crate::scratch::{BackwardPass, Scratch, take_front, take_whole, whole};
use crate::shape::Shape;

/// A chain of layers, itself a layer.
///
/// Convolutions, ReLUs and max-poolings that follow one another run fused, which changes no value
/// but by rounding. Its parameters are those of its layers in order. `forward` leaves every
/// activation in `scratch`, from where `backward` reads them: hand it the scratch that `forward` of
/// the same samples filled.
pub struct Sequential<T> {
    layers: Vec<Box<dyn Layer<T>>>,
    params: Vec<Range<usize>>,
    stages: Vec<Stage>,
    scratch_key: u64,
}

/// Layers that run as one.
struct Stage {
    layers: Range<usize>,
    /// Of the layers, if they begin with a convolution.
    fused: Option<Chain>,
}

/// Groups layers into stages: a convolution takes all layers behind it that can be fused with it.
fn stages<T: Scalar>(layers: &[Box<dyn Layer<T>>]) -> Vec<Stage> {
    let mut stages: Vec<Stage> = Vec::new();
    for (i, layer) in layers.iter().enumerate() {
        let kind = layer.kind();
        if let Some(last) = stages.last_mut()
            && let Some(chain) = &mut last.fused
            && extends(chain, &kind)
        {
            last.layers.end = i + 1;
            continue;
        }
        let fused = match kind {
            LayerKind::R2Conv(conv) => Some(Chain::new(conv)),
            _ => None,
        };
        let layers = i..i + 1;
        stages.push(Stage { layers, fused });
    }
    stages
}

/// Adds a layer to a chain if it can be fused with it.
fn extends<T: Scalar>(chain: &mut Chain, kind: &LayerKind<'_, T>) -> bool {
    match kind {
        LayerKind::R2Conv(conv) => chain.convolve(conv),
        LayerKind::Relu => chain.rectify(),
        LayerKind::MaxPool(kernel) => chain.pool(*kernel),
        _ => false,
    }
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
                return Err(LayerError::Mismatch { index: previous + 1, takes, gives });
            }
        }
        let mut end = 0;
        let params = layers.iter().map(|layer| {
            let start = end;
            end += layer.num_params();
            start..end
        });
        let printed: Vec<String> = layers.iter().map(|layer| layer.to_string()).collect();
        Ok(Sequential {
            params: params.collect(),
            stages: stages(&layers),
            scratch_key: hash_of(printed),
            layers,
        })
    }

    /// The layers, in order.
    pub fn layers(&self) -> &[Box<dyn Layer<T>>] {
        &self.layers
    }

    /// Range of the parameters of layer `index` among those of the chain.
    pub fn params_of(&self, index: usize) -> Range<usize> {
        self.params[index].clone()
    }

    /// The stages with their parameters.
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

    /// Writes what [`forward`](Layer::forward) would for pictures `[N, H, W, C]` whose bytes stand
    /// for their [`level`](crate::level)s, to the same bits. The levels are made where they are
    /// read.
    ///
    /// # Panics
    /// As `forward`; and when the first layer is no [`R2Conv`](crate::R2Conv) of trivial channels.
    pub fn forward_bytes(
        &self,
        params: &[T],
        pictures: &[u8],
        y: &mut [T],
        scratch: &mut Scratch<T>,
    ) {
        self.check_bytes();
        let samples = samples(self, ("pictures", pictures.len()));
        check_forward(self, samples, [params.len(), y.len()]);
        let x = (samples, Input::Bytes(pictures));
        self.run_from(params, x, y, empty(self, samples, scratch));
        fill(self, samples, scratch);
    }

    /// The backward pass of [`forward_bytes`](Sequential::forward_bytes), to the bits of
    /// [`backward`](Layer::backward); bytes have no gradient.
    ///
    /// # Panics
    /// As `forward_bytes` and `backward`.
    pub fn backward_bytes(
        &self,
        params: &[T],
        pictures: &[u8],
        [y, dy]: [&[T]; 2],
        dparams: &mut [T],
        scratch: &mut Scratch<T>,
    ) {
        self.check_bytes();
        let samples = samples(self, ("pictures", pictures.len()));
        let lens = [params.len(), y.len(), dy.len(), dparams.len()];
        check_backward(self, samples, lens);
        let pass = BackwardPass {
            params,
            x: &[],
            y,
            dy,
            dx: None,
            dparams,
            scratch: filled(self, samples, scratch),
        };
        self.run_back_to((samples, Input::Bytes(pictures)), pass);
    }

    /// Refuses bytes where no convolution reads them.
    fn check_bytes(&self) {
        assert!(
            self.stages[0].fused.is_some() && self.in_shape().fields.is_trivial(),
            "{self}: got bytes, which a convolution of trivial channels reads, expected such a \
             first layer"
        );
    }

    /// Runs the stages one after the other; `x` is not staged.
    fn run_from(
        &self,
        params: &[T],
        (samples, x): (usize, Input<T>),
        y: &mut [T],
        scratch: &mut [T],
    ) {
        let mut parts = self.parts(samples, scratch);
        let mut y = Some(y);
        let mut input = x;
        for (i, (layer, range)) in self.stages().enumerate() {
            let scratch = if layer.keeps_scratch() {
                take_whole(&mut parts.kept, layer.scratch_len(samples))
            } else {
                &mut parts.shared[..layer.scratch_len(samples)]
            };
            let output = match y.take_if(|_| i + 1 == self.stages.len()) {
                Some(y) => y,
                None => take_whole(&mut parts.activations, samples * layer.out_shape().len()),
            };
            match (input, &self.stages[i].fused) {
                (Input::Channels(x), _) => layer.run_forward(&params[range], x, output, scratch),
                (x, Some(chain)) => chain.forward(&params[range], (samples, x), output, scratch),
                (_, None) => unreachable!("bytes are for chains"),
            }
            input = Input::Channels(output);
        }
    }

    /// Runs them back to `x`, which the pass holds, if it is no bytes.
    fn run_back_to(&self, (samples, x): (usize, Input<T>), pass: BackwardPass<T>) {
        let mut parts = self.parts(samples, pass.scratch);
        let mut dx = pass.dx;
        let [mut output_gradient, mut input_gradient] = parts.gradients;
        let mut activations = &*parts.activations;
        let mut output = pass.y;
        for (i, (layer, range)) in (0..self.stages.len()).rev().zip(self.stages().rev()) {
            let (in_len, out_len) = (samples * layer.in_shape().len(), output.len());
            let (input, dx) = match i {
                0 => (pass.x, dx.take()),
                _ => {
                    let input = take_back(&mut activations, in_len);
                    (input, Some(&mut input_gradient[..in_len]))
                }
            };
            let pass = BackwardPass {
                params: &pass.params[range.clone()],
                x: input,
                y: output,
                dy: if i + 1 == self.stages.len() { pass.dy } else { &output_gradient[..out_len] },
                dx,
                dparams: &mut pass.dparams[range],
                scratch: if layer.keeps_scratch() {
                    take_back_mut(&mut parts.kept, layer.scratch_len(samples))
                } else {
                    &mut parts.shared[..layer.scratch_len(samples)]
                },
            };
            match (i, x, &self.stages[i].fused) {
                (0, Input::Bytes(_), Some(chain)) => chain.backward((samples, x), pass),
                _ => layer.run_backward(pass),
            }
            std::mem::swap(&mut output_gradient, &mut input_gradient);
            output = input;
        }
    }

    /// The parts of the scratch of this many samples.
    fn parts<'a>(&self, samples: usize, scratch: &'a mut [T]) -> Parts<'a, T> {
        let sizes = self.sizes(samples);
        let mut rest = scratch;
        Parts {
            activations: take_front(&mut rest, sizes.activations),
            kept: take_front(&mut rest, sizes.kept),
            gradients: [(); 2].map(|()| take_front(&mut rest, sizes.gradient)),
            shared: rest,
        }
    }

    fn sizes(&self, samples: usize) -> Sizes {
        let inner = self.stages().take(self.stages.len() - 1);
        let activations = inner.map(|(layer, _)| whole(samples * layer.out_shape().len()));
        let scratch = |kept| {
            let stages = self.stages().map(|(layer, _)| layer);
            let stages = stages.filter(move |layer| layer.keeps_scratch() == kept);
            stages.map(move |layer| whole(layer.scratch_len(samples)))
        };
        Sizes {
            activations: activations.clone().sum(),
            kept: scratch(true).sum(),
            gradient: activations.max().unwrap_or(0),
            shared: scratch(false).max().unwrap_or(0),
        }
    }
}

/// Lengths of the parts of a chain's scratch.
struct Sizes {
    /// Outputs of stages.
    activations: usize,
    /// The scratches of those stages that keep theirs.
    kept: usize,
    /// Each of two gradients of activations.
    gradient: usize,
    /// The scratch of the stages that do not keep theirs.
    shared: usize,
}

/// The parts of a chain's scratch.
struct Parts<'a, T> {
    activations: &'a mut [T],
    kept: &'a mut [T],
    gradients: [&'a mut [T]; 2],
    shared: &'a mut [T],
}

impl<T: Scalar> Signature for Sequential<T> {
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
        let sizes = self.sizes(samples);
        sizes.activations + sizes.kept + 2 * sizes.gradient + sizes.shared
    }

    fn keeps_scratch(&self) -> bool {
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

    fn draw(&self, rng: &mut dyn Rng, gain: f64, params: &mut [T]) {
        let scaled = self.layers.iter().rposition(|layer| layer.num_params() > 0);
        for (i, (layer, range)) in self.layers.iter().zip(&self.params).enumerate() {
            let params = &mut params[range.clone()];
            match scaled {
                Some(last) if last == i => layer.init_scaled(rng, gain, params),
                _ => layer.init(rng, params),
            }
        }
    }

    fn run_forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]) {
        let samples = x.len() / self.in_shape().len();
        self.run_from(params, (samples, Input::Channels(x)), y, scratch);
    }

    fn run_backward(&self, pass: BackwardPass<T>) {
        let samples = pass.x.len() / self.in_shape().len();
        let x = Input::Channels(pass.x);
        self.run_back_to((samples, x), pass);
    }
}

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

/// Takes values off the back, and what [`whole`] adds.
fn take_back<'a, T>(rest: &mut &'a [T], len: usize) -> &'a [T] {
    let (front, back) = rest.split_at(rest.len() - whole(len));
    *rest = front;
    &back[..len]
}

fn take_back_mut<'a, T>(rest: &mut &'a mut [T], len: usize) -> &'a mut [T] {
    let at = rest.len() - whole(len);
    let (front, back) = std::mem::take(rest).split_at_mut(at);
    *rest = front;
    &mut back[..len]
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
