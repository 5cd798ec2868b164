//! The two floating-point types that layers compute in.

use std::fmt::{Debug, Display};

use faer::traits::RealField;

use crate::conv_backward::Backward;
use crate::conv_forward::Forward;
use crate::lanes::{InstructionSet, Kernel, Portable, run_f32};

/// `f32` for training and `f64` for gradient checks.
pub trait Scalar:
    RealField + Copy + Default + Debug + Display + PartialOrd + Send + Sync + 'static
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

    /// Runs a forward pass; not generic, so that it is compiled once and with this crate's settings.
    #[doc(hidden)]
    fn forward(pass: Forward<Self>);

    /// The same for a backward pass.
    #[doc(hidden)]
    fn backward(pass: Backward<Self>);
}

impl Scalar for f32 {
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

    fn forward(pass: Forward<f32>) {
        run_f32(pass, InstructionSet::Avx512);
    }

    fn backward(pass: Backward<f32>) {
        run_f32(pass, InstructionSet::Avx512);
    }
}

impl Scalar for f64 {
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

    fn forward(pass: Forward<f64>) {
        pass.run(Portable);
    }

    fn backward(pass: Backward<f64>) {
        pass.run(Portable);
    }
}

/// Whether a running maximum moves on to this value; not a number counts as larger than anything.
#[inline(always)]
pub(crate) fn exceeds<T: Scalar>(value: T, best: T) -> bool {
    value > best || value.partial_cmp(&value).is_none()
}
