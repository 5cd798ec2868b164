//! From observations to equivariant fields: what actor and critic share.

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
/// is [`Encoder::Blind`](crate::Encoder::Blind) has no image encoder, and h is the vector's fields.
pub struct Trunk<T> {
    /// Those that the network was built with and for.
    pub settings: NetworkSettings,
    pub spec: EnvSpec,
    sight: Option<Sight<T>>,
    vector: Sequential<T>,
    pool: GroupMaxPool,
    /// Natural index of every irrep-major component of the vector.
    vector_order: Vec<usize>,
}

/// The image encoder, and how its fields join those of the vector.
struct Sight<T> {
    encoder: Sequential<T>,
    concat: Concat,
}

/// The parts of a trunk, for what runs them elsewhere.
pub struct Parts<'a, T> {
    /// The image encoder, and how its fields join those of the vector.
    pub sight: Option<(&'a Sequential<T>, &'a Concat)>,
    pub vector: &'a Sequential<T>,
    pub pool: &'a GroupMaxPool,
    /// Natural index of every irrep-major component of the vector.
    pub vector_order: &'a [usize],
}

/// Every activation, gradient and scratch of a trunk's pass over up to a fixed number of samples.
#[derive(Clone, Debug)]
pub struct TrunkPass<T> {
    image: Option<EncoderBuffers<T>>,
    vector: LayerBuffers<T>,
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
        let fields = settings.regular(settings.vector_fields);
        let vector = Sequential::new(lift(FieldType::from_irreps(group, &spec.vector), fields)?)?;
        let sight = Sight::new(settings, spec, vector.out_shape())?;
        let joint = sight.as_ref().map(|sight| sight.concat.out_shape());
        Ok(Self {
            pool: GroupMaxPool::new(joint.unwrap_or(vector.out_shape()))?,
            sight,
            vector,
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

    /// Where the parameters of the image encoder lie.
    pub fn encoder(&self) -> Range<usize> {
        let sight = self.sight.as_ref();
        0..sight.map_or(0, |sight| sight.encoder.num_params())
    }

    pub fn num_params(&self) -> usize {
        self.encoder().end + self.vector.num_params()
    }

    /// Where its parameters lie in those of a network.
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
        if let Some(sight) = &self.sight {
            let gain = self.settings.encoder.last_gain();
            sight
                .encoder
                .init_scaled(rng, gain, &mut params[self.encoder()]);
        }
        self.vector.init(rng, &mut params[self.vector_params()]);
        params
    }

    pub fn parts(&self) -> Parts<'_, T> {
        let sight = self.sight.as_ref();
        Parts {
            sight: sight.map(|sight| (&sight.encoder, &sight.concat)),
            vector: &self.vector,
            pool: &self.pool,
            vector_order: &self.vector_order,
        }
    }

    /// Buffers for up to `capacity` samples.
    pub fn pass(&self, capacity: usize) -> TrunkPass<T> {
        let sight = self.sight.as_ref();
        TrunkPass {
            image: sight.map(|sight| EncoderBuffers::new(&sight.encoder, capacity)),
            vector: LayerBuffers::new(&self.vector, capacity),
            pool: LayerBuffers::new(&self.pool, capacity),
        }
    }

    /// Writes sample `slot`: pixels `[H, W, C]`, which the encoder reads as numbers in [-0.5, 0.5],
    /// and the vector `[D]`, put into irrep-major order.
    pub fn load(&self, slot: usize, image: &[u8], vector: &[f32], pass: &mut TrunkPass<T>) {
        assert_len("image", image.len(), self.spec.image_len());
        assert_len("vector", vector.len(), self.vector_order.len());
        if let Some(sight) = &mut pass.image {
            sight.pictures[slot * image.len()..(slot + 1) * image.len()].copy_from_slice(image);
        }
        let components = &mut pass.vector.x[slot * vector.len()..(slot + 1) * vector.len()];
        for (x, &i) in components.iter_mut().zip(&self.vector_order) {
            *x = T::from_f64(f64::from(vector[i]));
        }
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
        let vector = n * self.vector.out_shape().len();
        pass.vector
            .forward(&self.vector, &params[self.vector_params()], n);
        let out = &mut pass.pool.x[..n * self.out_type().dim()];
        match (&self.sight, &mut pass.image) {
            (Some(sight), Some(image)) => {
                image.forward(&sight.encoder, &params[self.encoder()], n);
                let len = n * sight.encoder.out_shape().len();
                let vector = &pass.vector.y[..vector];
                sight.concat.forward(&image.y[..len], vector, out);
            }
            _ => out.copy_from_slice(&pass.vector.y[..vector]),
        }
    }

    /// Sums of what each unit puts out for the samples in slots 0..n.
    pub fn unit_sums(&self, params: &[T], n: usize, pass: &TrunkPass<T>) -> Vec<Vec<f64>> {
        let mut sums = match (&self.sight, &pass.image) {
            (Some(sight), Some(image)) => {
                image.unit_sums(&sight.encoder, &params[self.encoder()], n)
            }
            _ => Vec::new(),
        };
        let own = &params[self.vector_params()];
        sums.extend(pass.vector.unit_sums(&self.vector, own, n));
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
        let vector = n * self.vector.out_shape().len();
        let sum = &pass.pool.dx[..n * self.out_type().dim()];
        let d_vector = &mut pass.vector.dy[..vector];
        match (&self.sight, &mut pass.image) {
            (Some(sight), Some(image)) => {
                let len = n * sight.encoder.out_shape().len();
                sight.concat.backward(sum, &mut image.dy[..len], d_vector);
                let own = self.encoder();
                image.backward(&sight.encoder, &params[own.clone()], n, &mut dparams[own]);
            }
            _ => d_vector.copy_from_slice(sum),
        }
        let own = self.vector_params();
        pass.vector
            .backward(&self.vector, params, own, n, dparams, false);
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

impl<T: Scalar> Sight<T> {
    fn new(
        settings: &NetworkSettings,
        spec: &EnvSpec,
        vector: Shape,
    ) -> Result<Option<Self>, RlError> {
        let (group, top_fields) = (settings.group, settings.top_fields);
        let encoder = settings.encoder.layers(group, spec.image, top_fields)?;
        let Some(encoder) = encoder else {
            return Ok(None);
        };
        let concat = Concat::new(encoder.out_shape(), vector)?;
        Ok(Some(Self { encoder, concat }))
    }
}

fn lift<T: Scalar>(from: FieldType, to: FieldType) -> Result<Vec<Box<dyn Layer<T>>>, RlError> {
    Ok(vec![
        Box::new(Linear::new(from, to)?),
        Box::new(Relu::new(Shape::vector(to))?),
    ])
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
