//! Shapes of feature maps and the action of the group on them.

use std::fmt;
use std::slice::{ChunksExact, ChunksExactMut};

use symmetry::{D2, FieldType};

use crate::Scalar;

/// The shape of one sample: `[height, width, fields.dim()]`, channels last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Shape {
    /// Rows of pixels.
    pub height: usize,
    /// Columns of pixels.
    pub width: usize,
    /// How the channels transform.
    pub fields: FieldType,
}

impl Shape {
    /// A map of `height` x `width` pixels.
    pub const fn image(height: usize, width: usize, fields: FieldType) -> Shape {
        Shape {
            height,
            width,
            fields,
        }
    }

    /// A vector: a map of one pixel.
    pub const fn vector(fields: FieldType) -> Shape {
        Shape::image(1, 1, fields)
    }

    /// The number of values of one sample.
    #[expect(
        clippy::len_without_is_empty,
        reason = "an empty shape is of no use to anybody"
    )]
    pub fn len(&self) -> usize {
        self.pixels() * self.fields.dim()
    }

    /// The number of pixels.
    pub const fn pixels(&self) -> usize {
        self.height * self.width
    }

    /// The transformed copy of one sample: pixels move, and channels of odd irreps change sign.
    ///
    /// # Panics
    /// When `g` is not in the group of the type or `sample` does not hold [`len`](Shape::len) values.
    pub fn act<T: Scalar>(&self, g: D2, sample: &[T]) -> Vec<T> {
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

    /// The same, to be written.
    pub(crate) fn each_mut<'a, T>(&self, values: &'a mut [T]) -> ChunksExactMut<'a, T> {
        values.chunks_exact_mut(self.len().max(1))
    }

    /// Panics, naming the layer, unless slices of these lengths hold as many inputs of this shape as outputs of another.
    pub(crate) fn check_lens(&self, layer: &str, out_shape: Shape, [x, y]: [usize; 2]) {
        let (each, out_each) = (self.len(), out_shape.len());
        let samples = x / each.max(1);
        assert!(
            x == samples * each && y == samples * out_each,
            "{layer}: got an input of {x} values and an output of {y}, expected N * {each} and N * {out_each}"
        );
    }

    /// The number of samples in a slice of `len` values.
    ///
    /// # Panics
    /// When it is not a whole number.
    pub(crate) fn samples(&self, len: usize) -> usize {
        let each = self.len().max(1);
        assert!(
            len.is_multiple_of(each),
            "got {len} values, expected a multiple of {each} for {self}"
        );
        len / each
    }
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} x {} x ({})", self.height, self.width, self.fields)
    }
}
