//! Networks that the timing programs of this folder share.

use equivariant::{
    Group, Layer, LayerError, LayerSignature, MaxPool, R2Conv, Relu, Sequential, SlidingWindow,
};

/// Number of channels of an image.
pub const IMAGE_CHANNELS: usize = 6;
/// Window of the convolutions in networks without pooling, whose stride halves the image.
pub const HALVING_CONV_WINDOW: SlidingWindow = SlidingWindow::new(4, 2, 1);

/// Builds a network of convolutions with these numbers of regular fields of D2, each with a ReLU,
/// on images of `size` x `size` x 6. They halve the image, or are 3 x 3 and followed by pooling.
pub fn build_d2_conv_network(
    size: usize,
    fields: &[usize],
    pooled: bool,
) -> Result<Sequential<f32>, LayerError> {
    let kernel = if pooled { SlidingWindow::new(3, 1, 1) } else { HALVING_CONV_WINDOW };
    let mut layers: Vec<Box<dyn Layer<f32>>> = Vec::new();
    let (mut from, mut size) = (Group::D2.trivial_type(IMAGE_CHANNELS), size);
    for &n in fields {
        let conv = R2Conv::new(from, Group::D2.regular_type(n), kernel, [size; 2])?;
        let mut shape = conv.out_shape();
        layers.push(Box::new(conv));
        layers.push(Box::new(Relu::new(shape)?));
        if pooled {
            let pool = MaxPool::new(shape, SlidingWindow::new(2, 2, 0))?;
            shape = pool.out_shape();
            layers.push(Box::new(pool));
        }
        (from, size) = (shape.fields, shape.height);
    }
    Sequential::new(layers)
}
