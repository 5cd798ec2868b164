//! How the scratch of a pass is cut up.

use crate::real::Real;
use crate::simd::lanes::{Block, LANES};

/// Splits whole blocks off the front of a scratch, so that each starts on a cache line if the
/// scratch does.
pub(crate) struct Pieces<'a, T> {
    rest: &'a mut [Block<T>],
}

impl<'a, T: Real> Pieces<'a, T> {
    pub fn new(scratch: &'a mut [T]) -> Pieces<'a, T> {
        Pieces {
            rest: scratch.as_chunks_mut().0,
        }
    }

    /// Splits off values; a multiple of a block.
    pub fn take_flat(&mut self, len: usize) -> &'a mut [T] {
        self.take(len / LANES).as_flattened_mut()
    }

    pub fn take(&mut self, blocks: usize) -> &'a mut [Block<T>] {
        let (front, rest) = std::mem::take(&mut self.rest).split_at_mut(blocks);
        self.rest = rest;
        front
    }

    /// The same, filled with zeros.
    pub fn zeros(&mut self, blocks: usize) -> &'a mut [Block<T>] {
        let front = self.take(blocks);
        front.as_flattened_mut().fill(T::ZERO);
        front
    }

    /// Values that are zero; a multiple of a block.
    pub fn flat_zeros(&mut self, len: usize) -> &'a mut [T] {
        self.zeros(len / LANES).as_flattened_mut()
    }

    /// What is left.
    pub fn rest(self) -> &'a mut [T] {
        self.rest.as_flattened_mut()
    }
}
