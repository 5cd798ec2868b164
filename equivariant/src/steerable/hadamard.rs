//! Change between the irrep basis and the regular basis of regular fields.

use std::array::from_fn;

use symmetry::{FieldType, Group};

use crate::error::LayerError;
use crate::real::Real;
use crate::shape::Shape;

/// Returns the orthonormal Walsh-Hadamard transform of G = 1, 2 or 4 numbers; it is its own
/// inverse.
///
/// It maps the coefficients of the irreps to the values at the group elements, and back: out\[g\] =
/// 1/sqrt(G) sum_a a(g) in\[a\]. Flipping the signs of a group element on one side permutes the
/// other side, with the same bits.
#[inline(always)]
pub(crate) fn walsh_hadamard<T: Real, const G: usize>(mut values: [T; G]) -> [T; G] {
    let mut step = 1;
    while step < G {
        // G is a constant, so the compiler unrolls these loops into additions of registers
        for i in (0..G).filter(|i| i & step == 0) {
            let (a, b) = (values[i], values[i + step]);
            (values[i], values[i + step]) = (a + b, a - b);
        }
        step *= 2;
    }
    let scale = T::from_f64((G as f64).sqrt().recip());
    values.map(|value| value * scale)
}

/// Transforms regular fields of a group in place between the irrep basis and the regular basis.
///
/// `channels` are the |G| n channels of n fields: the coefficient of the i-th irrep of field f, or
/// its value at the i-th group element, lies at `i * n + f`. The transform is orthonormal and its
/// own inverse.
///
/// # Panics
/// When the number of channels is not a multiple of the group's order.
pub fn hadamard_transform<T: Real>(group: Group, channels: &mut [T]) {
    assert!(
        channels.len().is_multiple_of(group.order()),
        "got {} channels, expected a multiple of {}, the order of {group}",
        channels.len(),
        group.order()
    );
    let n = channels.len() / group.order();
    hadamard_transform_pixels(group.order(), n, channels);
}

/// Returns the number of channels per field and the number of fields of a field type with a basis
/// that the group permutes; `None` for a type without one.
///
/// Trivial channels are fields of order 1.
pub(crate) fn permuted_field_order_and_count(fields: FieldType) -> Option<(usize, usize)> {
    if fields.is_trivial() {
        return Some((1, fields.dim()));
    }
    let n = fields.num_regular_fields()?;
    Some((fields.group().order(), n))
}

/// Returns the number of channels per field and the number of fields of a feature map with a basis
/// that the group permutes; rejects other field types.
pub(crate) fn require_permuted_fields(
    layer: &'static str,
    shape: Shape,
) -> Result<(usize, usize), LayerError> {
    LayerError::check_feature_map_size(layer, shape, 0)?;
    permuted_field_order_and_count(shape.fields).ok_or(LayerError::InvalidFieldType {
        layer,
        got: shape.fields,
        expected: "regular fields only or trivial channels only",
    })
}

/// Transforms the n fields of every pixel in place between the irrep basis and the regular basis; a
/// field has `order` channels.
pub(crate) fn hadamard_transform_pixels<T: Real>(order: usize, n: usize, pixels: &mut [T]) {
    match order {
        1 => {}
        2 => transform_each::<T, 2>(n, pixels),
        _ => transform_each::<T, 4>(n, pixels),
    }
}

#[expect(clippy::needless_range_loop, reason = "f indexes every part of a pixel")]
fn transform_each<T: Real, const G: usize>(n: usize, pixels: &mut [T]) {
    for pixel in pixels.chunks_exact_mut((G * n).max(1)) {
        let parts = split_by_irrep_mut::<T, G>(pixel, n);
        for f in 0..n {
            let values = walsh_hadamard::<T, G>(from_fn(|a| parts[a][f]));
            for a in 0..G {
                parts[a][f] = values[a];
            }
        }
    }
}

/// Evaluates an expression in which `$order` is a constant with the value of `$value`: 1, 2 or 4.
macro_rules! with_const_order {
    ($order:ident = $value:expr, $result:expr) => {
        match $value {
            1 => {
                const $order: usize = 1;
                $result
            }
            2 => {
                const $order: usize = 2;
                $result
            }
            _ => {
                const $order: usize = 4;
                $result
            }
        }
    };
}

pub(crate) use with_const_order;

/// Splits the channels of one pixel of n regular fields by irrep.
#[inline(always)]
pub(crate) fn split_by_irrep<T, const G: usize>(pixel: &[T], n: usize) -> [&[T]; G] {
    from_fn(|a| &pixel[a * n..][..n])
}

/// Splits the channels of one pixel of n regular fields by irrep, mutably.
#[inline(always)]
pub(crate) fn split_by_irrep_mut<T, const G: usize>(
    mut pixel: &mut [T],
    n: usize,
) -> [&mut [T]; G] {
    from_fn(|_| {
        let (part, rest) = std::mem::take(&mut pixel).split_at_mut(n);
        pixel = rest;
        part
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_transform_is_that_of_the_signs() {
        let x = [0.3, -1.0, 2.0, 0.7];
        for group in Group::ALL {
            let order = group.order();
            let mut y = x[..order].to_vec();
            hadamard_transform(group, &mut y);
            for (&g, got) in group.elements().iter().zip(y) {
                let terms = group.irreps().iter().zip(x);
                let sum: f64 = terms.map(|(a, value)| f64::from(a.sign(g)) * value).sum();
                assert!((got - sum / (order as f64).sqrt()).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn signs_on_one_side_permute_the_other_bit_by_bit() {
        for group in Group::ALL {
            let values: Vec<f32> = (0..group.order()).map(|i| (i as f32).cos()).collect();
            let mut regular = values.clone();
            hadamard_transform(group, &mut regular);
            for &g in group.elements() {
                let mut signed = values.clone();
                group.regular_type(1).transform_channels(g, &mut signed);
                hadamard_transform(group, &mut signed);
                for (&h, value) in group.elements().iter().zip(signed) {
                    let source = group.elements().iter().position(|&e| e == g * h).unwrap();
                    assert_eq!(value, regular[source], "{group} {g} {h}");
                }
            }
        }
    }

    #[test]
    fn the_transform_of_fields_is_its_own_inverse() {
        let fields = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 9.0];
        let mut twice = fields;
        hadamard_transform(Group::D2, &mut twice);
        assert_ne!(twice, fields);
        hadamard_transform(Group::D2, &mut twice);
        assert_eq!(twice, fields);
    }

    #[test]
    #[should_panic(expected = "got 3 channels, expected a multiple of 2, the order of C2")]
    fn half_a_field_is_refused() {
        hadamard_transform(Group::C2, &mut [0.0; 3]);
    }
}
