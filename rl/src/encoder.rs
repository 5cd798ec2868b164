//! Image encoders, from images to one vector of regular fields.

use equivariant::{
    FieldType, Layer, MaxPool, R2Conv, Relu, Scalar, Sequential, Shape, SlidingWindow,
};
use serde::{Deserialize, Serialize};
use symmetry::Group;

use crate::error::RlError;

/// Kernel size, stride and padding of a convolution that halves an image: 4 x 4, 2 and 1 pixels. On
/// images with even sides its windows lie symmetrically, since (size + 2 - 4) mod 2 = 0, so the
/// layer is exactly equivariant.
const HALVING_CONV_WINDOW: SlidingWindow = SlidingWindow::new(4, 2, 1);
/// Kernel size, stride and padding of a convolution that keeps an image's size: 3 x 3, 1 and 1
/// pixels.
const SAME_SIZE_WINDOW: SlidingWindow = SlidingWindow::new(3, 1, 1);
/// Kernel size, stride and padding of a convolution that removes one pixel on every side of an
/// image: 3 x 3, 1 and 0 pixels.
const UNPADDED_WINDOW: SlidingWindow = SlidingWindow::new(3, 1, 0);
/// Window size, stride and padding of max-pooling: 2 x 2, 2 and 0 pixels.
pub(crate) const POOL_WINDOW: SlidingWindow = SlidingWindow::new(2, 2, 0);
/// Side in pixels of the feature maps after all halvings of [`EncoderSettings::Pooled`].
const POOLED_SIDE: usize = 8;

/// Kind and layer widths of the image encoder, which maps an image to a vector of regular fields
/// ([`NetworkSettings::top_fields`](crate::NetworkSettings::top_fields)). All kinds are exactly
/// equivariant. Widths are in regular fields of D2, see
/// [`NetworkSettings::group`](crate::NetworkSettings::group).
///
/// `Strided` and `Pooled` end in one pixel, so images that are not square are padded with black to
/// a square of their longer side; height and width must then differ by an even number. Environments
/// without images need no encoder, whatever the setting.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum EncoderSettings {
    /// Encoder of 4 x 4 convolutions of stride 2, then one whose window is the whole remaining
    /// feature map; a ReLU after each.
    ///
    /// Sides of images are multiples of 2 to the power of the number of halvings.
    Strided {
        /// Number of regular fields after each halving of the image, at least 1 each and at least
        /// one halving.
        fields: Vec<usize>,
    },
    /// Encoder of 3 x 3 convolutions with 2 x 2 max-pools, a ReLU after each convolution. From D.
    /// Wang et al., "SO(2)-equivariant reinforcement learning" (ICLR 2022, appendix on network
    /// architecture), whose caption COVERS repeats.
    ///
    /// After the halvings the maps have 8 x 8 pixels; two convolutions and a pool leave 3 x 3, and
    /// the last convolution 1 x 1. So sides of images are exactly 8 times 2 to the power of the
    /// number of halvings.
    Pooled {
        /// Number of regular fields after each halving of the image, at least 1 each; empty for
        /// images of 8 x 8 pixels.
        fields: Vec<usize>,
        /// Number of regular fields of each of the two convolutions at 8 x 8 pixels, at least 1;
        /// the second is not padded.
        inner: [usize; 2],
    },
    /// No encoder: the network reads the observation's vector only.
    Blind,
}

impl EncoderSettings {
    /// Returns every layer width of the encoder with the name of its setting. An empty list of
    /// required halvings counts as a width of zero, which the check of widths rejects.
    pub(crate) fn named_widths(&self) -> Vec<(&'static str, usize)> {
        let halving = |fields: &[usize]| {
            if fields.is_empty() { vec![0] } else { fields.to_vec() }
        };
        let (name, fields, others) = match self {
            Self::Strided { fields } => ("encoder.strided.fields", halving(fields), vec![]),
            Self::Pooled { fields, inner } => {
                let inner = inner.map(|width| ("encoder.pooled.inner", width));
                ("encoder.pooled.fields", fields.clone(), inner.to_vec())
            }
            Self::Blind => return Vec::new(),
        };
        let fields = fields.into_iter().map(|width| (name, width));
        fields.chain(others).collect()
    }

    /// Returns height, width and channels of the encoder's input, a canvas on which images of shape
    /// `image` `[height, width, channels]` are centred.
    ///
    /// # Errors
    /// [`RlError::UnsupportedImageSize`] if the image cannot be centred in a square.
    pub(crate) fn canvas_shape(&self, image: [usize; 3]) -> Result<[usize; 3], RlError> {
        let (encoder, fields) = match self {
            Self::Strided { fields } => ("strided", fields),
            Self::Pooled { fields, .. } => ("pooled", fields),
            Self::Blind => return Ok(image),
        };
        let [height, width, channels] = image;
        if !(height + width).is_multiple_of(2) {
            let expected = "a square, or sides that differ by an even number".to_owned();
            let halvings = fields.len();
            return Err(RlError::UnsupportedImageSize {
                height,
                width,
                encoder,
                halvings,
                expected,
            });
        }
        let side = height.max(width);
        Ok([side, side, channels])
    }

    /// Builds the encoder's layers, from an input `[height, width, channels]` to `top_fields`
    /// regular fields; `None` for [`EncoderSettings::Blind`] and if there are no images.
    pub(crate) fn layers<T: Scalar>(
        &self,
        group: Group,
        [height, width, channels]: [usize; 3],
        top_fields: usize,
    ) -> Result<Option<Sequential<T>>, RlError> {
        if height == 0 {
            return Ok(None);
        }
        let builder = || EncoderBuilder {
            group,
            layers: Vec::new(),
            shape: Shape::image(height, width, group.trivial_type(channels)),
        };
        let layers = match self {
            Self::Strided { fields } => builder().strided(fields, top_fields)?,
            Self::Pooled { fields, inner } => builder().pooled(fields, *inner, top_fields)?,
            Self::Blind => return Ok(None),
        };
        Ok(Some(Sequential::new(layers)?))
    }
}

/// Returns the number of regular fields of `group` that have as many channels as `fields` regular
/// fields of D2.
pub(crate) fn num_group_fields(group: Group, fields: usize) -> usize {
    fields * (Group::D2.order() / group.order())
}

type Layers<T> = Vec<Box<dyn Layer<T>>>;

/// Returns the side in pixels of an image that `halvings` halvings reduce to one pixel.
fn downsampling_factor(halvings: usize) -> usize {
    // the cap only avoids an overflow: no image is 2^31 pixels wide
    1 << halvings.min(31)
}

/// Builder of an encoder: the layers so far, and the shape of their output.
struct EncoderBuilder<T> {
    group: Group,
    layers: Layers<T>,
    shape: Shape,
}

impl<T: Scalar> EncoderBuilder<T> {
    fn strided(mut self, fields: &[usize], top_fields: usize) -> Result<Layers<T>, RlError> {
        self.check_multiple("strided", fields.len())?;
        self.conv_relu_halvings(fields)?;
        self.conv_relu(top_fields, SlidingWindow::new(self.shape.height, 1, 0))?;
        Ok(self.layers)
    }

    fn pooled(
        mut self,
        fields: &[usize],
        inner: [usize; 2],
        top_fields: usize,
    ) -> Result<Layers<T>, RlError> {
        let side = POOLED_SIDE * downsampling_factor(fields.len());
        let fits = self.shape.height == side;
        self.check("pooled", fields.len(), fits, format!("exactly {side} x {side}"))?;
        for &width in fields {
            self.conv_relu(width, SAME_SIZE_WINDOW)?;
            self.pool()?;
        }
        self.conv_relu(inner[0], SAME_SIZE_WINDOW)?;
        // from 8 x 8 to 6 x 6, 3 x 3 and 1 x 1 pixels
        self.conv_relu(inner[1], UNPADDED_WINDOW)?;
        self.pool()?;
        self.conv_relu(top_fields, UNPADDED_WINDOW)?;
        Ok(self.layers)
    }

    fn check_multiple(&self, encoder: &'static str, halvings: usize) -> Result<(), RlError> {
        let (Shape { height, width, .. }, of) = (self.shape, downsampling_factor(halvings));
        let fits = height.is_multiple_of(of) && width.is_multiple_of(of);
        let expected = format!("height and width to be multiples of {of}, at least {of}");
        self.check(encoder, halvings, fits, expected)
    }

    /// Rejects the image's size unless it `fits`: the encoder's layers must halve both sides
    /// exactly. The group does not matter, so that networks of all groups take the same images.
    fn check(
        &self,
        encoder: &'static str,
        halvings: usize,
        fits: bool,
        expected: String,
    ) -> Result<(), RlError> {
        if fits {
            return Ok(());
        }
        let Shape { height, width, .. } = self.shape;
        Err(RlError::UnsupportedImageSize { height, width, encoder, halvings, expected })
    }

    fn regular_field_type(&self, fields: usize) -> FieldType {
        self.group.regular_type(num_group_fields(self.group, fields))
    }

    fn conv_relu_halvings(&mut self, fields: &[usize]) -> Result<(), RlError> {
        fields.iter().try_for_each(|&fields| self.conv_relu(fields, HALVING_CONV_WINDOW))
    }

    fn conv_relu(&mut self, fields: usize, kernel: SlidingWindow) -> Result<(), RlError> {
        self.conv(fields, kernel)?;
        self.add(Relu::new(self.shape)?);
        Ok(())
    }

    fn conv(&mut self, fields: usize, kernel: SlidingWindow) -> Result<(), RlError> {
        let size = [self.shape.height, self.shape.width];
        let to = self.regular_field_type(fields);
        self.add(R2Conv::new(self.shape.fields, to, kernel, size)?);
        Ok(())
    }

    fn pool(&mut self) -> Result<(), RlError> {
        self.add(MaxPool::new(self.shape, POOL_WINDOW)?);
        Ok(())
    }

    fn add(&mut self, layer: impl Layer<T> + 'static) {
        self.shape = layer.out_shape();
        self.layers.push(Box::new(layer));
    }
}
