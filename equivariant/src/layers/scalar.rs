//! The two precisions that layers are compiled for.

use crate::conv::passes::Passes;

/// `f32` for training and `f64` for gradient checks. What they can do is in [`Real`](crate::Real).
pub trait Scalar: Passes {}

impl Scalar for f32 {}
impl Scalar for f64 {}
