//! Floating-point types of layers, and normal deviates for initial weights.

use std::f64::consts::TAU;
use std::fmt::{Debug, Display};
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

use rand::{Rng, RngExt};

use crate::matrix::MatrixProductOperands;

/// Arithmetic of single or double precision, `f32` or `f64`. Other types cannot implement it.
pub trait Real:
    Copy
    + Default
    + Debug
    + Display
    + PartialOrd
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
    + DivAssign
    + Send
    + Sync
    + 'static
{
    /// The number 0.
    const ZERO: Self;

    /// Rounds `value` to the nearest value of this type.
    fn from_f64(value: f64) -> Self;

    /// Converts the value to double precision.
    fn to_f64(self) -> f64;

    /// Returns e to the power of the value.
    fn exp(self) -> Self;

    /// Returns a number with these bits, so that slices of numbers can hold bit masks.
    #[doc(hidden)]
    fn from_mask(bits: u16) -> Self;

    /// Returns the bits that [`from_mask`](Real::from_mask) stored.
    #[doc(hidden)]
    fn to_mask(self) -> u16;

    /// Computes a matrix product in this precision.
    #[doc(hidden)]
    fn multiply_matrices(product: MatrixProductOperands<Self>);
}

macro_rules! real {
    ($float:ident) => {
        impl Real for $float {
            const ZERO: $float = 0.0;

            fn from_f64(value: f64) -> $float {
                value as $float
            }

            fn to_f64(self) -> f64 {
                self.into()
            }

            fn exp(self) -> $float {
                $float::exp(self)
            }

            #[inline(always)]
            fn from_mask(bits: u16) -> $float {
                // masks are only copied, never computed with: most are subnormal numbers
                $float::from_bits(bits.into())
            }

            #[inline(always)]
            fn to_mask(self) -> u16 {
                self.to_bits() as u16
            }

            fn multiply_matrices(product: MatrixProductOperands<$float>) {
                product.run();
            }
        }
    };
}

real!(f32);
real!(f64);

/// Returns `true` if `value` has to replace the running maximum `best`: if it exceeds `best` or is
/// NaN.
#[inline(always)]
pub(crate) fn exceeds_or_is_nan<T: Real>(value: T, best: T) -> bool {
    value > best || value.partial_cmp(&value).is_none()
}

/// Fills `out` with independent normal deviates of mean 0 and standard deviation `std` (Box and
/// Muller, 1958).
pub(crate) fn fill_normal<T: Real>(rng: &mut dyn Rng, std: f64, out: &mut [T]) {
    for pair in out.chunks_mut(2) {
        // 1 - u lies in (0, 1], where the logarithm is finite
        let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt() * std;
        let angle = TAU * rng.random::<f64>();
        let (sin, cos) = angle.sin_cos();
        let values = [radius * cos, radius * sin];
        for (target, value) in pair.iter_mut().zip(values) {
            *target = T::from_f64(value);
        }
    }
}
