//! The four irreducible representations of D2.

use std::fmt;
use std::ops::Mul;

use crate::d2::{D2, product};

/// Irreducible representation of D2: a sign for each group element.
///
/// Irrep `a` gives the element `g` the sign (-1)^popcount(a & g), on the two bits of both
/// (Serre, "Linear Representations of Finite Groups", section 3.1: commutative groups have
/// one-dimensional irreps). `X` and `Y` are different irreps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Irrep {
    /// Trivial representation: never changes sign.
    Trivial,
    /// Representation that changes sign under flip x and the half turn, as a coordinate x does.
    X,
    /// Representation that changes sign under flip y and the half turn, as a coordinate y does.
    Y,
    /// Representation that changes sign under both flips, as a product x y does.
    XY,
}

impl Irrep {
    /// All four irreps, in the order of the channel layout.
    pub const ALL: [Irrep; 4] = [Irrep::Trivial, Irrep::X, Irrep::Y, Irrep::XY];

    /// Returns the position of the irrep in [`Irrep::ALL`], in 0..4; its bits are those of the sign
    /// formula.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Returns the sign, 1 or -1, by which the group element `g` acts in this irrep.
    pub const fn sign(self, g: D2) -> i8 {
        if (self.index() & g.bits()).count_ones().is_multiple_of(2) { 1 } else { -1 }
    }
}

impl Mul for Irrep {
    type Output = Irrep;

    /// Returns the tensor product of two irreps: their signs multiply.
    fn mul(self, other: Irrep) -> Irrep {
        Irrep::ALL[product(self.index(), other.index())]
    }
}

impl fmt::Display for Irrep {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Irrep::Trivial => "1",
            Irrep::X => "x",
            Irrep::Y => "y",
            Irrep::XY => "xy",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signs_are_those_of_coordinates() {
        for g in D2::ALL {
            let [x, y] = g.apply_xy([1.0, 1.0]);
            assert_eq!(f64::from(Irrep::Trivial.sign(g)), 1.0);
            assert_eq!(f64::from(Irrep::X.sign(g)), x);
            assert_eq!(f64::from(Irrep::Y.sign(g)), y);
            assert_eq!(f64::from(Irrep::XY.sign(g)), x * y);
        }
    }

    #[test]
    fn signs_are_homomorphisms_of_the_group_and_of_the_irreps() {
        for a in Irrep::ALL {
            for g in D2::ALL {
                for h in D2::ALL {
                    assert_eq!(a.sign(g * h), a.sign(g) * a.sign(h));
                }
                for b in Irrep::ALL {
                    assert_eq!((a * b).sign(g), a.sign(g) * b.sign(g));
                }
            }
        }
    }
}
