//! Shapes of feature maps and the action of the group on them.

use std::fmt;
use std::slice::{ChunksExact, ChunksExactMut};

use symmetry::{D2, FieldType, Irrep};

use crate::real::Real;

/// Maximum number of values of a sample and of parameters of a layer. The product of two such
/// numbers, for example of samples and values of each, is 2^62 and fits into a `usize` of 64 bits.
pub(crate) const MAX_VALUES: usize = 1 << 31;

/// Shape of one sample: `[height, width, fields.dim()]`, channels last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Shape {
    /// Number of rows of pixels.
    pub height: usize,
    /// Number of columns of pixels.
    pub width: usize,
    /// Field type of the channels.
    pub fields: FieldType,
}

impl Shape {
    /// Creates the shape of a map of `height` x `width` pixels.
    pub const fn image(height: usize, width: usize, fields: FieldType) -> Shape {
        Shape { height, width, fields }
    }

    /// Creates the shape of a vector: a map of one pixel.
    pub const fn vector(fields: FieldType) -> Shape {
        Shape::image(1, 1, fields)
    }

    /// Returns the number of values of one sample.
    pub fn len(&self) -> usize {
        self.num_pixels() * self.fields.dim()
    }

    /// Returns `true` for a shape without values, which layers reject.
    pub fn is_empty(&self) -> bool {
        self.height == 0 || self.width == 0 || self.fields.dim() == 0
    }

    /// Returns the number of pixels of the map, height times width.
    pub const fn num_pixels(&self) -> usize {
        self.height * self.width
    }

    /// Returns a copy of one sample transformed by the group element `g`: pixels move, and channels
    /// change sign if `g` has the sign -1 in their irrep.
    ///
    /// # Panics
    /// When `g` is not in the group of the type or `sample` does not hold [`len`](Shape::len)
    /// values.
    pub fn transform_sample<T: Real>(&self, g: D2, sample: &[T]) -> Vec<T> {
        let dim = self.fields.dim();
        let mut moved = g.transform_image(sample, self.height, self.width, dim);
        for pixel in moved.chunks_exact_mut(dim.max(1)) {
            self.fields.transform_channels(g, pixel);
        }
        moved
    }

    /// Iterates over the samples of a slice of feature maps.
    pub(crate) fn samples<'a, T>(&self, values: &'a [T]) -> ChunksExact<'a, T> {
        // chunks of length 0 would panic
        values.chunks_exact(self.len().max(1))
    }

    /// Iterates mutably over the samples of a slice of feature maps.
    pub(crate) fn samples_mut<'a, T>(&self, values: &'a mut [T]) -> ChunksExactMut<'a, T> {
        values.chunks_exact_mut(self.len().max(1))
    }

    /// Returns the number of values of one sample with `padding` more pixels on each side; `None`
    /// if it exceeds [`MAX_VALUES`].
    pub(crate) fn padded_len(&self, padding: usize) -> Option<usize> {
        let padded = |size: usize| size.checked_add(padding.checked_mul(2)?);
        let dims = Irrep::ALL.map(|a| self.fields.multiplicity(a));
        let dim = dims.into_iter().try_fold(0, usize::checked_add)?;
        checked_product([padded(self.height)?, padded(self.width)?, dim])
    }
}

/// Returns the product of some sizes; `None` if it exceeds [`MAX_VALUES`].
pub(crate) fn checked_product<const N: usize>(sizes: [usize; N]) -> Option<usize> {
    let product = sizes.into_iter().try_fold(1, usize::checked_mul)?;
    (product <= MAX_VALUES).then_some(product)
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} x {} x ({})", self.height, self.width, self.fields)
    }
}
