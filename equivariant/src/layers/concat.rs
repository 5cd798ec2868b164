//! Direct sum of two feature maps.

use std::fmt;
use std::ops::Range;

use symmetry::Irrep;

use crate::error::LayerError;
use crate::shape::Shape;

/// Direct sum of two feature maps of equal height and width; within an irrep, the first map's
/// channels come first.
///
/// Channels stay irrep-major, so the sum interleaves the two maps irrep by irrep rather than
/// appending one pixel's channels to the other's. It has two inputs and hence is not a
/// [`Layer`](crate::Layer): it joins two networks.
#[derive(Clone, Copy, Debug)]
pub struct Concat {
    first: Shape,
    second: Shape,
    sum: Shape,
}

impl Concat {
    /// Creates the direct sum of maps of these shapes.
    ///
    /// # Errors
    /// When heights, widths or groups differ, a map is empty, or the sum is too large.
    pub fn new(first: Shape, second: Shape) -> Result<Concat, LayerError> {
        LayerError::check_groups("Concat", first.fields, second.fields)?;
        if [first.height, first.width] != [second.height, second.width] {
            return Err(LayerError::InvalidSetting {
                layer: "Concat",
                setting: "maps",
                got: format!("{first} and {second}"),
                expected: "equal heights and widths",
            });
        }
        LayerError::check_feature_map_size("Concat", first, 0)?;
        LayerError::check_feature_map_size("Concat", second, 0)?;
        let dim = first.fields.dim() + second.fields.dim();
        LayerError::check_channels("Concat", dim)?;
        let sum = Shape { fields: first.fields + second.fields, ..first };
        LayerError::check_feature_map_size("Concat", sum, 0)?;
        Ok(Concat { first, second, sum })
    }

    /// Returns the shapes of the two feature maps whose direct sum is formed.
    pub fn in_shapes(&self) -> [Shape; 2] {
        [self.first, self.second]
    }

    /// Returns the shape of the direct sum.
    pub fn out_shape(&self) -> Shape {
        self.sum
    }

    /// Writes the direct sum of both maps, which concatenates their channels irrep by irrep, for N
    /// samples into `y`.
    ///
    /// # Panics
    /// When the lengths of the slices do not agree.
    pub fn forward<T: Copy>(&self, first: &[T], second: &[T], y: &mut [T]) {
        self.check([first.len(), second.len()], "y", y.len());
        for [a, b, to_a, to_b] in self.channel_ranges(y.len()) {
            y[to_a].copy_from_slice(&first[a]);
            y[to_b].copy_from_slice(&second[b]);
        }
    }

    /// Splits a direct sum of two feature maps, or the gradient with respect to the sum, into the
    /// two maps.
    ///
    /// # Panics
    /// When the lengths of the slices do not agree.
    pub fn backward<T: Copy>(&self, dy: &[T], first: &mut [T], second: &mut [T]) {
        self.check([first.len(), second.len()], "dy", dy.len());
        for [a, b, from_a, from_b] in self.channel_ranges(dy.len()) {
            first[a].copy_from_slice(&dy[from_a]);
            second[b].copy_from_slice(&dy[from_b]);
        }
    }

    /// Iterates over the pixels of a direct sum of `len` values and over irreps; an item has four
    /// ranges: the channels in the first map, in the second, and of either in the sum.
    fn channel_ranges(&self, len: usize) -> impl Iterator<Item = [Range<usize>; 4]> {
        let fields = [self.first, self.second, self.sum].map(|shape| shape.fields);
        let dims = fields.map(|fields| fields.dim());
        let ranges = Irrep::ALL.map(|irrep| fields.map(|fields| fields.channel_range(irrep)));
        let pixels = 0..len / self.sum.fields.dim();
        pixels.flat_map(move |pixel| {
            ranges.clone().map(|ranges| {
                let starts = [0, 1, 2].map(|map| pixel * dims[map] + ranges[map].start);
                let [first, second] = [ranges[0].len(), ranges[1].len()];
                let middle = starts[2] + first;
                [
                    starts[0]..starts[0] + first,
                    starts[1]..starts[1] + second,
                    starts[2]..middle,
                    middle..middle + second,
                ]
            })
        })
    }

    /// Panics unless all slices hold the same number of samples; `sum` is the name of the output.
    fn check(&self, inputs: [usize; 2], sum: &str, got: usize) {
        let each = self.sum.len();
        assert!(
            got.is_multiple_of(each),
            "{self}: got {sum} of {got} values, expected a multiple of {each}"
        );
        let samples = got / each;
        let names = ["first", "second"].into_iter().zip(inputs);
        for ((name, len), shape) in names.zip(self.in_shapes()) {
            let expected = samples * shape.len();
            assert!(
                len == expected,
                "{self}: got {name} of {len} values, expected {expected} to match {sum}"
            );
        }
    }
}

impl fmt::Display for Concat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Concat({}, {})", self.first, self.second)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use symmetry::{FieldType, Group};

    #[test]
    fn channels_are_interleaved_by_irrep() {
        let a = Shape::vector(FieldType::new(Group::D2, [1, 0, 2, 0]));
        let b = Shape::vector(FieldType::new(Group::D2, [1, 1, 1, 0]));
        let concat = Concat::new(a, b).unwrap();
        assert_eq!(concat.out_shape().fields.to_string(), "2 1 + 1 x + 3 y");
        let (x, y) = ([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [10.0, 20.0, 30.0, 40.0, 50.0, 60.0]);
        let mut sum = [0.0; 12];
        concat.forward(&x, &y, &mut sum);
        assert_eq!(sum[..6], [1.0, 10.0, 20.0, 2.0, 3.0, 30.0]);
        let (mut dx, mut dy) = ([0.0; 6], [0.0; 6]);
        concat.backward(&sum, &mut dx, &mut dy);
        assert_eq!((dx, dy), (x, y));
    }
}
