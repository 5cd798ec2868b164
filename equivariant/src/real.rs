//! The numbers that layers compute with.

use std::fmt::{Debug, Display};
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

use crate::matrix::{Strided, StridedMut, product};

/// Arithmetic of `f32` or `f64`; no other type can have it.
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

    /// The nearest value of this type.
    fn from_f64(value: f64) -> Self;

    /// The value in double precision.
    fn to_f64(self) -> f64;

    /// e to the power of the value.
    fn exp(self) -> Self;

    /// A number that keeps these bits, not their value.
    #[doc(hidden)]
    fn from_mask(bits: u16) -> Self;

    /// The bits that it keeps.
    #[doc(hidden)]
    fn to_mask(self) -> u16;

    /// Writes a b into `to`, or adds it to what is there.
    #[doc(hidden)]
    fn product(to: StridedMut<Self>, add: bool, a: Strided<Self>, b: Strided<Self>);
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
                $float::from_bits(bits.into())
            }

            #[inline(always)]
            fn to_mask(self) -> u16 {
                self.to_bits() as u16
            }

            fn product(to: StridedMut<$float>, add: bool, a: Strided<$float>, b: Strided<$float>) {
                product(to, add, a, b);
            }
        }
    };
}

real!(f32);
real!(f64);

/// Whether a running maximum moves on to this value; not a number counts as larger than anything.
#[inline(always)]
pub(crate) fn exceeds<T: Real>(value: T, best: T) -> bool {
    value > best || value.partial_cmp(&value).is_none()
}
