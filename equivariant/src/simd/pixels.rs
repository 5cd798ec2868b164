//! Pictures of trivial channels, as numbers or as bytes.

use crate::real::Real;
use crate::simd::lanes::{LANES, Lanes};

/// What a byte is multiplied with.
const UNIT: f64 = 1.0 / 255.0;
/// What is subtracted then.
const CENTRE: f64 = 0.5;

/// The number that a byte of a picture stands for, in [-0.5, 0.5].
#[inline(always)]
pub fn level<T: Real>(byte: u8) -> T {
    T::from_f64(f64::from(byte)) * T::from_f64(UNIT) - T::from_f64(CENTRE)
}

/// A value of a picture.
pub(crate) trait Pixel<T>: Copy {
    /// The number that it stands for.
    fn number(self) -> T;

    /// The numbers of sixteen of them.
    fn numbers<L: Lanes<T>>(lanes: L, pixels: &[Self; LANES]) -> L::V;
}

impl<T: Real> Pixel<T> for T {
    #[inline(always)]
    fn number(self) -> T {
        self
    }

    #[inline(always)]
    fn numbers<L: Lanes<T>>(lanes: L, pixels: &[T; LANES]) -> L::V {
        lanes.load(pixels)
    }
}

/// Bytes stand for their [`level`]s, with the same rounding one by one and sixteen at a time.
impl<T: Real> Pixel<T> for u8 {
    #[inline(always)]
    fn number(self) -> T {
        level(self)
    }

    #[inline(always)]
    fn numbers<L: Lanes<T>>(lanes: L, pixels: &[u8; LANES]) -> L::V {
        let unit = lanes.mul(lanes.bytes(pixels), lanes.splat(T::from_f64(UNIT)));
        lanes.sub(unit, lanes.splat(T::from_f64(CENTRE)))
    }
}
