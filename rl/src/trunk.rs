//! From observations to equivariant fields: what actor and critic share.

#[cfg(feature = "wgpu")]
use std::borrow::Cow;
use std::ops::Range;

use equivariant::{
    Concat, FieldType, GroupMaxPool, Layer, Linear, Relu, Scalar, Scratch, Sequential, Shape,
    Signature, level, unit_sums,
};
use rand::Rng;
use symmetry::irrep_order;

use crate::env::{EnvSpec, Observations};
use crate::error::{RlError, assert_len};
use crate::network_settings::NetworkSettings;

/// The shared part of a network, with the settings and the spec of all of it.
///
/// ```text
/// image  [H, W, C] -> Encoder ------+
/// vector [D]       -> Linear, ReLU -+-> h, regular fields -> GroupMaxPool -> features [F]
/// ```
///
/// Its parameters are those of the image encoder, then those of the vector's layer. A network that
/// is [`Encoder::Blind`](crate::Encoder::Blind), or for environments without images, has no image
/// encoder, and h is the vector's fields; where there is no vector, h is the image's.
pub struct Trunk<T> {
    /// Settings and spec that the network was built with and for.
    pub settings: NetworkSettings,
    pub spec: EnvSpec,
    /// Height, width and channels of what the encoder sees.
    canvas: [usize; 3],
    encoder: Option<Sequential<T>>,
    vector: Option<Sequential<T>>,
    /// Joins the fields of both.
    concat: Option<Concat>,
    pool: GroupMaxPool,
    /// Natural index of every irrep-major component of the vector.
    vector_order: Vec<usize>,
}

/// The parts of a trunk, for what runs them elsewhere.
pub struct Parts<'a, T> {
    pub encoder: Option<&'a Sequential<T>>,
    pub vector: Option<&'a Sequential<T>>,
    /// Joins the fields of both.
    pub concat: Option<&'a Concat>,
    pub pool: &'a GroupMaxPool,
    /// Natural index of every irrep-major component of the vector.
    pub vector_order: &'a [usize],
}

/// Every activation, gradient and scratch of a trunk's pass over up to a fixed number of samples.
#[derive(Clone, Debug)]
pub struct TrunkPass<T> {
    image: Option<EncoderBuffers<T>>,
    vector: Option<LayerBuffers<T>>,
    pool: LayerBuffers<T>,
}

/// A network that begins with a trunk.
pub trait HasTrunk<T> {
    fn trunk(&self) -> &Trunk<T>;
}

/// The buffers of such a network.
pub trait HasTrunkPass<T> {
    fn trunk(&mut self) -> &mut TrunkPass<T>;
}

impl<T: Scalar> Trunk<T> {
    pub fn new(settings: &NetworkSettings, spec: &EnvSpec) -> Result<Self, RlError> {
        settings.check()?;
        spec.check()?;
        let group = settings.group;
        let canvas = settings.encoder.canvas(spec.image)?;
        let encoder = settings.encoder.layers(group, canvas, settings.top_fields)?;
        let fields = settings.regular(settings.vector_fields);
        let from = (!spec.vector.is_empty()).then(|| FieldType::from_irreps(group, &spec.vector));
        let vector = from.map(|from| Ok::<_, RlError>(Sequential::new(lift(from, fields)?)?));
        let vector = vector.transpose()?;
        let shapes = [&encoder, &vector].map(|part| part.as_ref().map(Signature::out_shape));
        let (joint, concat) = match shapes {
            [Some(image), Some(vector)] => {
                let concat = Concat::new(image, vector)?;
                (concat.out_shape(), Some(concat))
            }
            [Some(alone), None] | [None, Some(alone)] => (alone, None),
            [None, None] => return Err(RlError::NothingObserved),
        };
        Ok(Self {
            pool: GroupMaxPool::new(joint)?,
            canvas,
            encoder,
            vector,
            concat,
            vector_order: irrep_order(group, &spec.vector),
            settings: settings.clone(),
            spec: spec.clone(),
        })
    }

    /// The type of h.
    pub fn out_type(&self) -> FieldType {
        self.pool.in_shape().fields
    }

    /// F, the length of the invariant features: one per regular field of the group.
    pub fn feature_dim(&self) -> usize {
        self.pool.out_shape().len()
    }

    /// Range of the image encoder's parameters.
    pub fn encoder(&self) -> Range<usize> {
        0..self.encoder.as_ref().map_or(0, Signature::num_params)
    }

    pub fn num_params(&self) -> usize {
        let vector = self.vector.as_ref();
        self.encoder().end + vector.map_or(0, Signature::num_params)
    }

    /// Range of its parameters in those of a network.
    pub fn params(&self) -> Range<usize> {
        0..self.num_params()
    }

    fn vector_params(&self) -> Range<usize> {
        self.encoder().end..self.num_params()
    }

    /// The `num_params` parameters of a whole network, of which its own are drawn: weights followed
    /// by a ReLU with gain sqrt(2), zero biases. The others are zeros.
    pub fn init(&self, num_params: usize, rng: &mut dyn Rng) -> Vec<T> {
        let mut params = vec![T::ZERO; num_params];
        if let Some(encoder) = &self.encoder {
            let gain = self.settings.encoder.last_gain();
            encoder.init_scaled(rng, gain, &mut params[self.encoder()]);
        }
        if let Some(vector) = &self.vector {
            vector.init(rng, &mut params[self.vector_params()]);
        }
        params
    }

    pub fn parts(&self) -> Parts<'_, T> {
        Parts {
            encoder: self.encoder.as_ref(),
            vector: self.vector.as_ref(),
            concat: self.concat.as_ref(),
            pool: &self.pool,
            vector_order: &self.vector_order,
        }
    }

    /// Buffers for up to `capacity` samples.
    pub fn pass(&self, capacity: usize) -> TrunkPass<T> {
        let (encoder, vector) = (self.encoder.as_ref(), self.vector.as_ref());
        TrunkPass {
            image: encoder.map(|encoder| EncoderBuffers::new(encoder, capacity)),
            vector: vector.map(|vector| LayerBuffers::new(vector, capacity)),
            pool: LayerBuffers::new(&self.pool, capacity),
        }
    }

    /// Writes sample `slot`: pixels `[H, W, C]`, which the encoder reads as numbers in [-0.5, 0.5],
    /// and the vector `[D]`, put into irrep-major order.
    pub fn load(&self, slot: usize, image: &[u8], vector: &[f32], pass: &mut TrunkPass<T>) {
        assert_len("image", image.len(), self.spec.image_len());
        assert_len("vector", vector.len(), self.vector_order.len());
        if let Some(encoder) = &mut pass.image {
            let len = self.canvas.iter().product::<usize>();
            self.centre(image, &mut encoder.pictures[slot * len..(slot + 1) * len]);
        }
        if let Some(layer) = &mut pass.vector {
            let components = &mut layer.x[slot * vector.len()..(slot + 1) * vector.len()];
            for (x, &i) in components.iter_mut().zip(&self.vector_order) {
                *x = T::from_f64(f64::from(vector[i]));
            }
        }
    }

    /// Copies a picture to the middle of a canvas.
    fn centre(&self, image: &[u8], canvas: &mut [u8]) {
        let ([height, width, channels], [rows, columns, _]) = (self.spec.image, self.canvas);
        let (top, left) = ((rows - height) / 2, (columns - width) / 2);
        for (row, pixels) in image.chunks_exact(width * channels).enumerate() {
            let start = ((top + row) * columns + left) * channels;
            canvas[start..start + pixels.len()].copy_from_slice(pixels);
        }
    }

    /// Pictures `[N, H, W, C]` as the encoder sees them.
    #[cfg(feature = "wgpu")]
    pub fn canvases<'i>(&self, images: &'i [u8]) -> Cow<'i, [u8]> {
        if self.canvas == self.spec.image {
            return Cow::Borrowed(images);
        }
        let (image, canvas) = (self.spec.image_len(), self.canvas.iter().product());
        let mut canvases = vec![0; images.len() / image * canvas];
        for (image, canvas) in images.chunks(image).zip(canvases.chunks_mut(canvas)) {
            self.centre(image, canvas);
        }
        Cow::Owned(canvases)
    }

    /// Writes the observations in `range` into the slots from 0 on.
    pub fn load_all(
        &self,
        observations: &Observations,
        range: Range<usize>,
        pass: &mut TrunkPass<T>,
    ) {
        for (slot, i) in range.enumerate() {
            let (image, vector) = observations.sample(&self.spec, i);
            self.load(slot, image, vector, pass);
        }
    }

    /// Computes h of the samples in slots 0..n.
    pub fn forward(&self, params: &[T], n: usize, pass: &mut TrunkPass<T>) {
        let (mut image, mut vector): (&[T], &[T]) = (&[], &[]);
        if let (Some(layers), Some(buffers)) = (&self.encoder, &mut pass.image) {
            image = buffers.forward(layers, &params[self.encoder()], n);
        }
        if let (Some(layers), Some(buffers)) = (&self.vector, &mut pass.vector) {
            vector = buffers.forward(layers, &params[self.vector_params()], n);
        }
        let out = &mut pass.pool.x[..n * self.pool.in_shape().len()];
        match &self.concat {
            Some(concat) => concat.forward(image, vector, out),
            None if self.vector.is_none() => out.copy_from_slice(image),
            None => out.copy_from_slice(vector),
        }
    }

    /// Sums of what each unit puts out for the samples in slots 0..n.
    pub fn unit_sums(&self, params: &[T], n: usize, pass: &TrunkPass<T>) -> Vec<Vec<f64>> {
        let mut sums = Vec::new();
        if let (Some(layers), Some(buffers)) = (&self.encoder, &pass.image) {
            sums.extend(buffers.unit_sums(layers, &params[self.encoder()], n));
        }
        if let (Some(layers), Some(buffers)) = (&self.vector, &pass.vector) {
            sums.extend(buffers.unit_sums(layers, &params[self.vector_params()], n));
        }
        sums
    }

    /// h of the samples in slots 0..n.
    pub fn fields<'p>(&self, n: usize, pass: &'p TrunkPass<T>) -> &'p [T] {
        &pass.fields()[..n * self.out_type().dim()]
    }

    /// Computes the invariant features of the n samples of the last forward pass.
    pub fn pool(&self, n: usize, pass: &mut TrunkPass<T>) {
        pass.pool.forward(&self.pool, &[], n);
    }

    /// Brings a gradient in the features, `[n, F]`, to h.
    pub fn pool_backward(&self, dfeatures: &[T], n: usize, pass: &mut TrunkPass<T>) {
        pass.pool.dy[..dfeatures.len()].copy_from_slice(dfeatures);
        pass.pool.backward(&self.pool, &[], 0..0, n, &mut [], true);
    }

    /// Adds the gradient in the parameters to `dparams`, from that in h: [`TrunkPass::d_fields`].
    pub fn backward(&self, params: &[T], n: usize, pass: &mut TrunkPass<T>, dparams: &mut [T]) {
        let sum = &pass.pool.dx[..n * self.pool.in_shape().len()];
        let len = |layers: &Sequential<T>| n * layers.out_shape().len();
        let (mut d_image, mut d_vector): (&mut [T], &mut [T]) = (&mut [], &mut []);
        if let (Some(layers), Some(buffers)) = (&self.encoder, &mut pass.image) {
            d_image = &mut buffers.dy[..len(layers)];
        }
        if let (Some(layers), Some(buffers)) = (&self.vector, &mut pass.vector) {
            d_vector = &mut buffers.dy[..len(layers)];
        }
        match &self.concat {
            Some(concat) => concat.backward(sum, d_image, d_vector),
            None if self.vector.is_none() => d_image.copy_from_slice(sum),
            None => d_vector.copy_from_slice(sum),
        }
        if let (Some(layers), Some(buffers)) = (&self.encoder, &mut pass.image) {
            let own = self.encoder();
            buffers.backward(layers, &params[own.clone()], n, &mut dparams[own]);
        }
        if let (Some(layers), Some(buffers)) = (&self.vector, &mut pass.vector) {
            buffers.backward(layers, params, self.vector_params(), n, dparams, false);
        }
    }
}

impl<T: Scalar> TrunkPass<T> {
    /// h of the samples in all slots; those beyond the last forward pass are of an earlier one.
    pub fn fields(&self) -> &[T] {
        &self.pool.x
    }

    /// The features of the samples in all slots.
    pub fn features(&self) -> &[T] {
        &self.pool.y
    }

    /// The gradient in h, to be written before the backward pass.
    pub fn d_fields(&mut self) -> &mut [T] {
        &mut self.pool.dx
    }
}

fn lift<T: Scalar>(from: FieldType, to: FieldType) -> Result<Vec<Box<dyn Layer<T>>>, RlError> {
    Ok(vec![Box::new(Linear::new(from, to)?), Box::new(Relu::new(Shape::vector(to))?)])
}

/// Linear, ReLU, Linear.
pub(crate) fn head<T: Scalar>(
    from: FieldType,
    hidden: FieldType,
    to: FieldType,
) -> Result<Sequential<T>, RlError> {
    let mut layers = lift(from, hidden)?;
    layers.push(Box::new(Linear::new(hidden, to)?));
    Ok(Sequential::new(layers)?)
}

/// Consecutive ranges of parameters, from 0 on.
pub(crate) struct Layout(usize);

impl Layout {
    /// After the parameters of a trunk.
    pub fn after<T: Scalar>(trunk: &Trunk<T>) -> Self {
        Self(trunk.num_params())
    }

    pub fn new() -> Self {
        Self(0)
    }

    pub fn next(&mut self, len: usize) -> Range<usize> {
        self.0 += len;
        self.0 - len..self.0
    }
}

/// Buffers of one layer for up to a fixed number of samples: input and output with their gradients,
/// and the layer's scratch.
#[derive(Clone, Debug)]
pub(crate) struct LayerBuffers<T> {
    pub x: Vec<T>,
    pub y: Vec<T>,
    pub dx: Vec<T>,
    pub dy: Vec<T>,
    scratch: Scratch<T>,
}

impl<T: Scalar> LayerBuffers<T> {
    pub fn new(layer: &impl Layer<T>, samples: usize) -> Self {
        let zeros = |len| vec![T::ZERO; len];
        let (input, output) = (samples * layer.in_shape().len(), samples * layer.out_shape().len());
        Self {
            x: zeros(input),
            y: zeros(output),
            dx: zeros(input),
            dy: zeros(output),
            scratch: layer.scratch(samples),
        }
    }

    /// Runs the first n samples and returns what they give.
    pub fn forward(&mut self, layer: &impl Layer<T>, params: &[T], n: usize) -> &[T] {
        let (x, y) = (n * layer.in_shape().len(), n * layer.out_shape().len());
        layer.forward(params, &self.x[..x], &mut self.y[..y], &mut self.scratch);
        &self.y[..y]
    }

    /// Sums of what each unit puts out for the first n samples, a list for each ReLU.
    pub fn unit_sums(&self, layer: &impl Layer<T>, params: &[T], n: usize) -> Vec<Vec<f64>> {
        unit_sums(layer, params, &self.x[..n * layer.in_shape().len()])
    }

    /// Adds the gradient in the parameters `range`, and writes that in the input if it is wanted.
    pub fn backward(
        &mut self,
        layer: &impl Layer<T>,
        params: &[T],
        range: Range<usize>,
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

/// Buffers for up to a fixed number of pictures: they, the output with its gradient, and the
/// encoder's scratch.
#[derive(Clone, Debug)]
pub(crate) struct EncoderBuffers<T> {
    /// `[N, H, W, C]`, bytes.
    pub pictures: Vec<u8>,
    pub y: Vec<T>,
    pub dy: Vec<T>,
    scratch: Scratch<T>,
}

impl<T: Scalar> EncoderBuffers<T> {
    pub fn new(encoder: &Sequential<T>, samples: usize) -> Self {
        let output = samples * encoder.out_shape().len();
        Self {
            pictures: vec![0; samples * encoder.in_shape().len()],
            y: vec![T::ZERO; output],
            dy: vec![T::ZERO; output],
            scratch: encoder.scratch(samples),
        }
    }

    /// Runs the first n pictures and returns what they give.
    pub fn forward(&mut self, encoder: &Sequential<T>, params: &[T], n: usize) -> &[T] {
        let (x, y) = (n * encoder.in_shape().len(), n * encoder.out_shape().len());
        let (pictures, y) = (&self.pictures[..x], &mut self.y[..y]);
        encoder.forward_bytes(params, pictures, y, &mut self.scratch);
        y
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
        encoder.backward_bytes(params, &self.pictures[..x], outputs, dparams, &mut self.scratch);
    }
}
