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

impl Real for f32 {
    const ZERO: f32 = 0.0;

    fn from_f64(value: f64) -> f32 {
        value as f32
    }

    fn to_f64(self) -> f64 {
        f64::from(self)
    }

    fn exp(self) -> f32 {
        f32::exp(self)
    }

    #[inline(always)]
    fn from_mask(bits: u16) -> f32 {
        f32::from_bits(bits.into())
    }

    #[inline(always)]
    fn to_mask(self) -> u16 {
        self.to_bits() as u16
    }

    fn product(to: StridedMut<f32>, add: bool, a: Strided<f32>, b: Strided<f32>) {
        product(to, add, a, b);
    }
}

impl Real for f64 {
    const ZERO: f64 = 0.0;

    fn from_f64(value: f64) -> f64 {
        value
    }

    fn to_f64(self) -> f64 {
        self
    }

    fn exp(self) -> f64 {
        f64::exp(self)
    }

    #[inline(always)]
    fn from_mask(bits: u16) -> f64 {
        f64::from_bits(bits.into())
    }

    #[inline(always)]
    fn to_mask(self) -> u16 {
        self.to_bits() as u16
    }

    fn product(to: StridedMut<f64>, add: bool, a: Strided<f64>, b: Strided<f64>) {
        product(to, add, a, b);
    }
}

/// Whether a running maximum moves on to this value; not a number counts as larger than anything.
#[inline(always)]
pub(crate) fn exceeds<T: Real>(value: T, best: T) -> bool {
    value > best || value.partial_cmp(&value).is_none()
}
