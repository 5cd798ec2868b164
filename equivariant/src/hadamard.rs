//! The change between the irrep basis and the regular basis of regular fields.

use crate::Scalar;

/// The orthonormal Walsh-Hadamard transform of four numbers; its own inverse.
///
/// Maps the coefficients of the irrep basis to the values at the four group elements, and back:
/// out\[g\] = 1/2 sum_a (-1)^popcount(a & g) in\[a\].
#[inline(always)]
pub(crate) fn hadamard4<T: Scalar>([a, b, c, d]: [T; 4]) -> [T; 4] {
    let half = T::from_f64(0.5);
    let (ab, a_b, cd, c_d) = (a + b, a - b, c + d, c - d);
    [
        (ab + cd) * half,
        (a_b + c_d) * half,
        (ab - cd) * half,
        (a_b - c_d) * half,
    ]
}

/// Transforms regular fields in place between the irrep basis and the regular basis.
///
/// `channels` are the 4 n channels of n fields: coefficient a of field f, or its value at group element a,
/// lies at `a * n + f`. The transform is orthonormal and its own inverse.
///
/// # Panics
/// When the number of channels is not a multiple of 4.
pub fn hadamard<T: Scalar>(channels: &mut [T]) {
    assert!(
        channels.len().is_multiple_of(4),
        "got {} channels, expected a multiple of 4",
        channels.len()
    );
    let n = channels.len() / 4;
    for f in 0..n {
        let values = hadamard4([0, 1, 2, 3].map(|a| channels[a * n + f]));
        for (a, value) in values.into_iter().enumerate() {
            channels[a * n + f] = value;
        }
    }
}

/// Splits the channels of one pixel into those of the four irreps.
#[inline(always)]
pub(crate) fn quarters<T>(pixel: &[T], n: usize) -> [&[T]; 4] {
    let (ab, cd) = pixel[..4 * n].split_at(2 * n);
    let (a, b) = ab.split_at(n);
    let (c, d) = cd.split_at(n);
    [a, b, c, d]
}

/// The same, to be written.
#[inline(always)]
pub(crate) fn quarters_mut<T>(pixel: &mut [T], n: usize) -> [&mut [T]; 4] {
    let (ab, cd) = pixel[..4 * n].split_at_mut(2 * n);
    let (a, b) = ab.split_at_mut(n);
    let (c, d) = cd.split_at_mut(n);
    [a, b, c, d]
}

#[cfg(test)]
mod tests {
    use super::*;
    use symmetry::{D2, Irrep};

    #[test]
    fn the_transform_is_that_of_the_signs() {
        let x = [0.3, -1.0, 2.0, 0.7];
        let y = hadamard4(x);
        for g in D2::ALL {
            let sum: f64 = Irrep::ALL
                .iter()
                .map(|a| f64::from(a.sign(g)) * x[a.index()])
                .sum();
            assert!((y[g.bits()] - sum / 2.0).abs() < 1e-15);
        }
    }

    #[test]
    fn the_transform_of_fields_is_its_own_inverse() {
        let fields = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 9.0];
        let mut twice = fields;
        hadamard(&mut twice);
        assert_ne!(twice, fields);
        hadamard(&mut twice);
        assert_eq!(twice, fields);
    }
}
