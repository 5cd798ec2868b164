//! Shapes of feature maps and the action of the group on them.

use std::fmt;
use std::slice::{ChunksExact, ChunksExactMut};

use symmetry::{D2, FieldType, Irrep};

use crate::real::Real;

/// Values that a sample or a layer's parameters may have at most. The product of two such numbers,
/// such as the values of this many samples, is 2^62 and fits into a `usize` of 64 bits.
pub(crate) const LARGEST: usize = 1 << 31;

/// The shape of one sample: `[height, width, fields.dim()]`, channels last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Shape {
    /// Rows of pixels.
    pub height: usize,
    /// Columns of pixels.
    pub width: usize,
    /// Types of the channels.
    pub fields: FieldType,
}

impl Shape {
    /// A map of `height` x `width` pixels.
    pub const fn image(height: usize, width: usize, fields: FieldType) -> Shape {
        Shape { height, width, fields }
    }

    /// A vector: a map of one pixel.
    pub const fn vector(fields: FieldType) -> Shape {
        Shape::image(1, 1, fields)
    }

    /// The number of values of one sample.
    pub fn len(&self) -> usize {
        self.pixels() * self.fields.dim()
    }

    /// `true` if it has no values; layers refuse such shapes.
    pub fn is_empty(&self) -> bool {
        self.height == 0 || self.width == 0 || self.fields.dim() == 0
    }

    /// The number of pixels.
    pub const fn pixels(&self) -> usize {
        self.height * self.width
    }

    /// The transformed copy of one sample: pixels move, and channels of odd irreps change sign.
    ///
    /// # Panics
    /// When `g` is not in the group of the type or `sample` does not hold [`len`](Shape::len)
    /// values.
    pub fn act<T: Real>(&self, g: D2, sample: &[T]) -> Vec<T> {
        let dim = self.fields.dim();
        let mut moved = g.transform_image(sample, self.height, self.width, dim);
        for pixel in moved.chunks_exact_mut(dim.max(1)) {
            self.fields.act(g, pixel);
        }
        moved
    }

    /// The samples of a slice.
    pub(crate) fn each<'a, T>(&self, values: &'a [T]) -> ChunksExact<'a, T> {
        values.chunks_exact(self.len().max(1))
    }

    /// The samples of a slice to be written.
    pub(crate) fn each_mut<'a, T>(&self, values: &'a mut [T]) -> ChunksExactMut<'a, T> {
        values.chunks_exact_mut(self.len().max(1))
    }

    /// The number of values with `padding` pixels on each side; none if it is more than
    /// [`LARGEST`].
    pub(crate) fn padded_len(&self, padding: usize) -> Option<usize> {
        let padded = |size: usize| size.checked_add(padding.checked_mul(2)?);
        let dims = Irrep::ALL.map(|a| self.fields.multiplicity(a));
        let dim = dims.into_iter().try_fold(0, usize::checked_add)?;
        product([padded(self.height)?, padded(self.width)?, dim])
    }
}

/// The product of sizes; none if it is more than [`LARGEST`].
pub(crate) fn product<const N: usize>(sizes: [usize; N]) -> Option<usize> {
    let product = sizes.into_iter().try_fold(1, usize::checked_mul)?;
    (product <= LARGEST).then_some(product)
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} x {} x ({})", self.height, self.width, self.fields)
    }
}
