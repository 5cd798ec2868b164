//! Basis functions on the taps of a kernel, each of a pure parity under the group.

use std::collections::BTreeMap;

use symmetry::{FieldType, Group, Irrep};

/// Orthonormal basis of the functions on the k x k taps of a kernel, each with the signs of one
/// irrep of the group.
///
/// An orbit of taps {g t} carries, for every irrep a, the function sum_g a(g) delta(g t), unless
/// the taps that g leaves in place cancel it. D2 folds along both axes, D1x and D1y along one, C2
/// pairs a tap with the one opposite, and C1 leaves every tap alone. The functions are ordered by
/// irrep, then by the first tap of their orbit, row-major.
///
/// A function of parity p takes input irrep a to output irrep a p. The columns of output irrep
/// b are therefore ordered by function and then by the channels of input irrep b p.
#[derive(Clone, Debug)]
pub(crate) struct TapBasis {
    pub in_type: FieldType,
    /// Side of the kernel in pixels.
    pub kernel_size: usize,
    /// Basis functions, ordered by parity and then by the first tap of their orbit.
    pub basis_functions: Vec<TapFunction>,
}

/// Basis function on the taps of a kernel, on which the group acts by the signs of one irrep.
#[derive(Clone, Debug)]
pub(crate) struct TapFunction {
    /// Irrep by whose signs the group acts on the function.
    pub parity: Irrep,
    /// Taps `[row, column]` with coefficients; the first tap identifies the orbit.
    pub tap_coefficients: Vec<([usize; 2], f64)>,
}

impl TapBasis {
    pub fn new(in_type: FieldType, size: usize) -> TapBasis {
        let group = in_type.group();
        let functions = group.irreps().iter().flat_map(|&parity| {
            (0..size * size)
                .filter_map(move |t| basis_function(group, size, parity, [t / size, t % size]))
        });
        TapBasis { in_type, kernel_size: size, basis_functions: functions.collect() }
    }

    /// Returns the input irrep that a function of this parity maps to output irrep b.
    pub fn input_irrep_for_parity(&self, b: Irrep, parity: Irrep) -> Irrep {
        self.in_type.group().restrict_d2_irrep(b * parity)
    }

    /// Returns the first column, in the weight matrix of output irrep b, that belongs to basis
    /// function `function`.
    pub fn first_weight_column(&self, b: Irrep, function: usize) -> usize {
        let before = self.basis_functions[..function].iter();
        before.map(|f| self.in_type.multiplicity(self.input_irrep_for_parity(b, f.parity))).sum()
    }

    /// Returns the number of columns of the weight matrix of output irrep b; 0 if the group lacks
    /// b.
    pub fn num_weight_columns(&self, b: Irrep) -> usize {
        if self.in_type.group().restrict_d2_irrep(b) == b {
            self.first_weight_column(b, self.basis_functions.len())
        } else {
            0
        }
    }
}

/// Returns the basis function of this parity on the orbit of `tap`; `None` if it vanishes or `tap`
/// is not the first of its orbit.
fn basis_function(
    group: Group,
    size: usize,
    parity: Irrep,
    tap: [usize; 2],
) -> Option<TapFunction> {
    let mut sums = BTreeMap::new();
    for &g in group.elements() {
        let (row, col) = g.apply_pixel(tap[0], tap[1], size, size);
        *sums.entry([row, col]).or_insert(0.0) += f64::from(parity.sign(g));
    }
    // taps that an element leaves in place may cancel, which makes the function zero
    let norm = sums.values().map(|s| s * s).sum::<f64>().sqrt();
    let first = sums.first_key_value().is_some_and(|(t, _)| *t == tap);
    (first && norm > 0.0).then(|| TapFunction {
        parity,
        tap_coefficients: sums.into_iter().map(|(t, s)| (t, s / norm)).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_ordered_by_parity_tap_and_channel() {
        let taps = TapBasis::new(FieldType::new(Group::C2, [2, 3, 0, 0]), 3);
        // 5 even functions on 2 channels, then 4 odd ones on 3
        assert_eq!(taps.num_weight_columns(Irrep::Trivial), 22);
        assert_eq!(taps.first_weight_column(Irrep::Trivial, 6), 13);
        assert_eq!(taps.num_weight_columns(Irrep::X), 5 * 3 + 4 * 2);
        assert_eq!(taps.num_weight_columns(Irrep::Y), 0);
    }
}
