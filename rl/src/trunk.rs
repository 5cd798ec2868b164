//! The trunk of a network: the layers that actor and critic share, from observations to equivariant
//! fields.

#[cfg(feature = "wgpu")]
use std::borrow::Cow;
use std::ops::Range;

use equivariant::{
    Concat, FieldType, GroupMaxPool, Layer, LayerSignature, Linear, Relu, Scalar, Scratch,
    Sequential, Shape, absolute_activation_sums, pixel_byte_to_float,
};
use rand::Rng;
use symmetry::irrep_major_permutation;

use crate::env::{EnvSpec, Observations};
use crate::error::{RlError, assert_len};
use crate::network_settings::NetworkSettings;

/// Layers that a network's actor and critic share, with settings and spec of the whole network.
///
/// ```text
/// image  [H, W, C] -> Encoder ------+
/// vector [D]       -> Linear, ReLU -+-> h, regular fields -> GroupMaxPool -> features [F]
/// ```
///
/// Parameters are those of the image encoder, then those of the vector's layer. With
/// [`EncoderSettings::Blind`](crate::EncoderSettings::Blind) or without images there is no image
/// encoder, and h consists of the vector's fields; without a vector, h consists of the image's
/// fields.
pub struct Trunk<T> {
    /// Settings that the network was built with.
    pub settings: NetworkSettings,
    pub spec: EnvSpec,
    /// Height, width and channels of the image encoder's input, on which images are centred.
    canvas: [usize; 3],
    pub encoder: Option<Sequential<T>>,
    pub vector: Option<Sequential<T>>,
    /// Layer that concatenates the regular fields of image and vector; `None` unless there are
    /// both.
    pub concat: Option<Concat>,
    pub pool: GroupMaxPool,
    /// Indices of the components of the observation vector in the environment's order, sorted by
    /// irrep (irrep-major order).
    pub vector_order: Vec<usize>,
}

/// Activations, gradients and scratch memory of a [`Trunk`]'s passes over up to a fixed number of
/// samples.
#[derive(Clone, Debug)]
pub struct TrunkWorkspace<T> {
    image: Option<EncoderWorkspace<T>>,
    vector: Option<LayerWorkspace<T>>,
    pool: LayerWorkspace<T>,
}

/// A network that begins with a [`Trunk`], the layers that its actor and critics share.
pub trait HasTrunk<T> {
    fn trunk(&self) -> &Trunk<T>;
}

/// Buffers for the passes of a network that begins with a [`Trunk`].
pub trait HasTrunkWorkspace<T> {
    fn trunk(&mut self) -> &mut TrunkWorkspace<T>;
}

impl<T: Scalar> Trunk<T> {
    pub fn new(settings: &NetworkSettings, spec: &EnvSpec) -> Result<Self, RlError> {
        settings.check()?;
        spec.check()?;
        let group = settings.group;
        let canvas = settings.encoder.canvas_shape(spec.image_shape)?;
        let encoder = settings.encoder.layers(group, canvas, settings.top_fields)?;
        let fields = settings.regular_field_type(settings.vector_fields);
        let from = (!spec.vector_irreps.is_empty())
            .then(|| FieldType::from_irreps(group, &spec.vector_irreps));
        let layers = |input| Ok::<_, RlError>(Sequential::new(linear_relu(input, fields)?)?);
        let vector = from.map(layers).transpose()?;
        let shapes = [&encoder, &vector].map(|part| part.as_ref().map(LayerSignature::out_shape));
        let (joint, concat) = match shapes {
            [Some(of_image), Some(of_vector)] => {
                let concat = Concat::new(of_image, of_vector)?;
                (concat.out_shape(), Some(concat))
            }
            [Some(alone), None] | [None, Some(alone)] => (alone, None),
            [None, None] => return Err(RlError::NoObservationInput),
        };
        Ok(Self {
            pool: GroupMaxPool::new(joint)?,
            canvas,
            encoder,
            vector,
            concat,
            vector_order: irrep_major_permutation(group, &spec.vector_irreps),
            settings: settings.clone(),
            spec: spec.clone(),
        })
    }

    /// Returns the field type of h, the features that actor and critic share.
    pub fn out_type(&self) -> FieldType {
        self.pool.in_shape().fields
    }

    /// Returns F, the length of the invariant features: one per regular field of the group.
    pub fn feature_dim(&self) -> usize {
        self.pool.out_shape().len()
    }

    /// Returns the range of the image encoder's parameters in the network's flat parameter slice.
    pub fn encoder_param_range(&self) -> Range<usize> {
        0..self.encoder.as_ref().map_or(0, LayerSignature::num_params)
    }

    pub fn num_params(&self) -> usize {
        let vector = self.vector.as_ref();
        self.encoder_param_range().end + vector.map_or(0, LayerSignature::num_params)
    }

    /// Returns the range of the trunk's parameters in the network's flat parameter slice.
    pub fn param_range(&self) -> Range<usize> {
        0..self.num_params()
    }

    fn vector_params(&self) -> Range<usize> {
        self.encoder_param_range().end..self.num_params()
    }

    /// Returns `num_params` initial parameters for a whole network: the trunk's weights are random,
    /// with gain sqrt(2) before a ReLU; its biases and all other parameters are zeros.
    pub fn init_params(&self, num_params: usize, rng: &mut dyn Rng) -> Vec<T> {
        let mut params = vec![T::ZERO; num_params];
        if let Some(encoder) = &self.encoder {
            encoder.init(rng, &mut params[self.encoder_param_range()]);
        }
        if let Some(vector) = &self.vector {
            vector.init(rng, &mut params[self.vector_params()]);
        }
        params
    }

    /// Allocates buffers for passes of the trunk over up to `capacity` samples.
    pub fn new_workspace(&self, capacity: usize) -> TrunkWorkspace<T> {
        let (encoder, vector) = (self.encoder.as_ref(), self.vector.as_ref());
        TrunkWorkspace {
            image: encoder.map(|encoder| EncoderWorkspace::new(encoder, capacity)),
            vector: vector.map(|vector| LayerWorkspace::new(vector, capacity)),
            pool: LayerWorkspace::new(&self.pool, capacity),
        }
    }

    /// Loads an observation into position `slot` of `workspace`: pixels `[H, W, C]`, which the
    /// encoder maps to [-0.5, 0.5], and the vector `[D]`, reordered to irrep-major order.
    pub fn load_observation(
        &self,
        slot: usize,
        image: &[u8],
        vector: &[f32],
        workspace: &mut TrunkWorkspace<T>,
    ) {
        assert_len("image", image.len(), self.spec.image_len());
        assert_len("vector", vector.len(), self.vector_order.len());
        if let Some(encoder) = &mut workspace.image {
            let len = self.canvas.iter().product::<usize>();
            self.centre(image, &mut encoder.pixels[slot * len..(slot + 1) * len]);
        }
        if let Some(layer) = &mut workspace.vector {
            let components = &mut layer.x[slot * vector.len()..(slot + 1) * vector.len()];
            for (x, &i) in components.iter_mut().zip(&self.vector_order) {
                *x = T::from_f64(f64::from(vector[i]));
            }
        }
    }

    /// Copies an image to the centre of `canvas`, the encoder's input, so that a flip of the input
    /// flips the image in place.
    fn centre(&self, image: &[u8], canvas: &mut [u8]) {
        let ([height, width, channels], [rows, columns, _]) = (self.spec.image_shape, self.canvas);
        let (top, left) = ((rows - height) / 2, (columns - width) / 2);
        for (row, pixels) in image.chunks_exact(width * channels).enumerate() {
            let start = ((top + row) * columns + left) * channels;
            canvas[start..start + pixels.len()].copy_from_slice(pixels);
        }
    }

    /// Returns the images `[N, H, W, C]`, each padded with black to the encoder's input size.
    #[cfg(feature = "wgpu")]
    pub fn pad_to_input_size<'i>(&self, images: &'i [u8]) -> Cow<'i, [u8]> {
        if self.canvas == self.spec.image_shape {
            return Cow::Borrowed(images);
        }
        let (image, canvas) = (self.spec.image_len(), self.canvas.iter().product());
        let mut centre_on_canvas = vec![0; images.len() / image * canvas];
        for (source, target) in images.chunks(image).zip(centre_on_canvas.chunks_mut(canvas)) {
            self.centre(source, target);
        }
        Cow::Owned(centre_on_canvas)
    }

    /// Loads the observations at indices `range` into the slots of `workspace` from 0 on.
    pub fn load_observations(
        &self,
        observations: &Observations,
        range: Range<usize>,
        workspace: &mut TrunkWorkspace<T>,
    ) {
        for (slot, i) in range.enumerate() {
            let (image, vector) = observations.image_and_vector(&self.spec, i);
            self.load_observation(slot, image, vector, workspace);
        }
    }

    /// Computes h, the features that actor and critic share, for the samples in slots 0..n.
    pub fn forward(&self, params: &[T], n: usize, workspace: &mut TrunkWorkspace<T>) {
        let (mut image, mut vector): (&[T], &[T]) = (&[], &[]);
        if let (Some(layers), Some(buffers)) = (&self.encoder, &mut workspace.image) {
            image = buffers.forward(layers, &params[self.encoder_param_range()], n);
        }
        if let (Some(layers), Some(buffers)) = (&self.vector, &mut workspace.vector) {
            vector = buffers.forward(layers, &params[self.vector_params()], n);
        }
        let out = &mut workspace.pool.x[..n * self.pool.in_shape().len()];
        match &self.concat {
            Some(concat) => concat.forward(image, vector, out),
            None if self.vector.is_none() => out.copy_from_slice(image),
            None => out.copy_from_slice(vector),
        }
    }

    /// Returns the sum of each ReLU unit's outputs over the samples in slots 0..n, one list for
    /// each ReLU.
    pub fn unit_activation_sums(
        &self,
        params: &[T],
        n: usize,
        workspace: &TrunkWorkspace<T>,
    ) -> Vec<Vec<f64>> {
        let mut sums = Vec::new();
        if let (Some(layers), Some(buffers)) = (&self.encoder, &workspace.image) {
            sums.extend(buffers.unit_activation_sums(
                layers,
                &params[self.encoder_param_range()],
                n,
            ));
        }
        if let (Some(layers), Some(buffers)) = (&self.vector, &workspace.vector) {
            sums.extend(buffers.unit_activation_sums(layers, &params[self.vector_params()], n));
        }
        sums
    }

    /// Returns h, the features that actor and critic share, of the samples in slots 0..n.
    pub fn feature_fields<'p>(&self, n: usize, workspace: &'p TrunkWorkspace<T>) -> &'p [T] {
        &workspace.feature_fields()[..n * self.out_type().dim()]
    }

    /// Computes the invariant features of the n samples of the last forward pass.
    pub fn pool_features(&self, n: usize, workspace: &mut TrunkWorkspace<T>) {
        workspace.pool.forward(&self.pool, &[], n);
    }

    /// Computes the gradient of the loss with respect to h, the fields before pooling, from the
    /// gradient with respect to the invariant features, `[n, F]`.
    pub fn pool_features_backward(
        &self,
        dfeatures: &[T],
        n: usize,
        workspace: &mut TrunkWorkspace<T>,
    ) {
        workspace.pool.dy[..dfeatures.len()].copy_from_slice(dfeatures);
        workspace.pool.backward(&self.pool, &[], 0..0, n, &mut [], true);
    }

    /// Adds the gradient of the loss with respect to the trunk's parameters to `dparams`, from the
    /// gradient with respect to h in [`TrunkWorkspace::d_feature_fields`].
    pub fn backward(
        &self,
        params: &[T],
        n: usize,
        workspace: &mut TrunkWorkspace<T>,
        dparams: &mut [T],
    ) {
        let sum = &workspace.pool.dx[..n * self.pool.in_shape().len()];
        let len = |layers: &Sequential<T>| n * layers.out_shape().len();
        let (mut d_image, mut d_vector): (&mut [T], &mut [T]) = (&mut [], &mut []);
        if let (Some(layers), Some(buffers)) = (&self.encoder, &mut workspace.image) {
            d_image = &mut buffers.dy[..len(layers)];
        }
        if let (Some(layers), Some(buffers)) = (&self.vector, &mut workspace.vector) {
            d_vector = &mut buffers.dy[..len(layers)];
        }
        match &self.concat {
            Some(concat) => concat.backward(sum, d_image, d_vector),
            None if self.vector.is_none() => d_image.copy_from_slice(sum),
            None => d_vector.copy_from_slice(sum),
        }
        if let (Some(layers), Some(buffers)) = (&self.encoder, &mut workspace.image) {
            let own = self.encoder_param_range();
            buffers.backward(layers, &params[own.clone()], n, &mut dparams[own]);
        }
        if let (Some(layers), Some(buffers)) = (&self.vector, &mut workspace.vector) {
            // no gradient with respect to the observation, which nothing would read
            buffers.backward(layers, params, self.vector_params(), n, dparams, false);
        }
    }
}

impl<T: Scalar> TrunkWorkspace<T> {
    /// Returns h, the features that actor and critic share, of all slots; slots beyond the last
    /// forward pass hold values of an earlier one.
    pub fn feature_fields(&self) -> &[T] {
        &self.pool.x
    }

    /// Returns the invariant features of all slots; those beyond the last pooled samples are of an
    /// earlier pass.
    pub fn features(&self) -> &[T] {
        &self.pool.y
    }

    /// Returns the array for the gradient of the loss with respect to h, which the caller writes
    /// before the backward pass.
    pub fn d_feature_fields(&mut self) -> &mut [T] {
        &mut self.pool.dx
    }
}

/// Builds a linear layer between two field types and a ReLU after it.
fn linear_relu<T: Scalar>(
    from: FieldType,
    to: FieldType,
) -> Result<Vec<Box<dyn Layer<T>>>, RlError> {
    Ok(vec![Box::new(Linear::new(from, to)?), Box::new(Relu::new(Shape::vector(to))?)])
}

/// Builds the layers of an actor or a critic: Linear, ReLU, Linear.
pub(crate) fn head<T: Scalar>(
    from: FieldType,
    hidden: FieldType,
    to: FieldType,
) -> Result<Sequential<T>, RlError> {
    let mut layers = linear_relu(from, hidden)?;
    layers.push(Box::new(Linear::new(hidden, to)?));
    Ok(Sequential::new(layers)?)
}

/// Allocator of consecutive ranges of a flat parameter slice.
pub(crate) struct ParamAllocator(usize);

impl ParamAllocator {
    /// Creates an allocator whose first range follows the parameters of `trunk`.
    pub fn starting_after_trunk<T: Scalar>(trunk: &Trunk<T>) -> Self {
        Self(trunk.num_params())
    }

    pub fn new() -> Self {
        Self(0)
    }

    pub fn allocate(&mut self, len: usize) -> Range<usize> {
        self.0 += len;
        self.0 - len..self.0
    }
}

/// Buffers of one layer for up to a fixed number of samples: input, output, their gradients, and
/// scratch memory.
#[derive(Clone, Debug)]
pub(crate) struct LayerWorkspace<T> {
    pub x: Vec<T>,
    pub y: Vec<T>,
    pub dx: Vec<T>,
    pub dy: Vec<T>,
    scratch: Scratch<T>,
}

impl<T: Scalar> LayerWorkspace<T> {
    pub fn new(layer: &impl Layer<T>, samples: usize) -> Self {
        let zeros = |len| vec![T::ZERO; len];
        let (input, output) = (samples * layer.in_shape().len(), samples * layer.out_shape().len());
        Self {
            x: zeros(input),
            y: zeros(output),
            dx: zeros(input),
            dy: zeros(output),
            scratch: layer.allocate_scratch(samples),
        }
    }

    /// Runs `layer` forward on the first n samples and returns its output.
    pub fn forward(&mut self, layer: &impl Layer<T>, params: &[T], n: usize) -> &[T] {
        let (x, y) = (n * layer.in_shape().len(), n * layer.out_shape().len());
        layer.forward(params, &self.x[..x], &mut self.y[..y], &mut self.scratch);
        &self.y[..y]
    }

    /// Returns the sum of each ReLU unit's outputs over the first n samples, one list for each
    /// ReLU.
    pub fn unit_activation_sums(
        &self,
        layer: &impl Layer<T>,
        params: &[T],
        n: usize,
    ) -> Vec<Vec<f64>> {
        absolute_activation_sums(layer, params, &self.x[..n * layer.in_shape().len()])
    }

    /// Runs `layer` backward: adds the gradient with respect to its parameters, which are those in
    /// `range`, to `dparams`, and computes the gradient with respect to its input if `input_too`.
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

/// Buffers of an image encoder for up to a fixed number of images: their pixels, its output with
/// the gradient, and scratch memory.
#[derive(Clone, Debug)]
pub(crate) struct EncoderWorkspace<T> {
    /// Pixels of N images `[N, H, W, C]`, one byte for each channel.
    pub pixels: Vec<u8>,
    pub y: Vec<T>,
    pub dy: Vec<T>,
    scratch: Scratch<T>,
}

impl<T: Scalar> EncoderWorkspace<T> {
    pub fn new(encoder: &Sequential<T>, samples: usize) -> Self {
        let output = samples * encoder.out_shape().len();
        Self {
            pixels: vec![0; samples * encoder.in_shape().len()],
            y: vec![T::ZERO; output],
            dy: vec![T::ZERO; output],
            scratch: encoder.allocate_scratch(samples),
        }
    }

    /// Runs the encoder forward on the first n images and returns its output.
    pub fn forward(&mut self, encoder: &Sequential<T>, params: &[T], n: usize) -> &[T] {
        let (x, y) = (n * encoder.in_shape().len(), n * encoder.out_shape().len());
        let (pixels, y) = (&self.pixels[..x], &mut self.y[..y]);
        encoder.forward_from_bytes(params, pixels, y, &mut self.scratch);
        y
    }

    /// Returns the sum of each ReLU unit's outputs over the first n images, one list for each ReLU.
    pub fn unit_activation_sums(
        &self,
        encoder: &Sequential<T>,
        params: &[T],
        n: usize,
    ) -> Vec<Vec<f64>> {
        let pixels = &self.pixels[..n * encoder.in_shape().len()];
        let x: Vec<T> = pixels.iter().map(|&byte| pixel_byte_to_float(byte)).collect();
        absolute_activation_sums(encoder, params, &x)
    }

    /// Adds the gradient of the loss with respect to the encoder's parameters to `dparams`, from
    /// the gradient with respect to its output.
    pub fn backward(&mut self, encoder: &Sequential<T>, params: &[T], n: usize, dparams: &mut [T]) {
        let (x, y) = (n * encoder.in_shape().len(), n * encoder.out_shape().len());
        let outputs = [&self.y[..y], &self.dy[..y]];
        encoder.backward_from_bytes(params, &self.pixels[..x], outputs, dparams, &mut self.scratch);
    }
}
