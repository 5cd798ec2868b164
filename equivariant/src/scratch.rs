//! The memory that the passes of a layer read and write.

use std::fmt;

use crate::real::Real;

/// Bytes of a cache line, on which scratches start.
const LINE: usize = 64;
/// Numbers that are skipped at most to get to one, of the narrowest type.
const SLACK: usize = LINE / size_of::<f32>();

/// Memory for the passes of a layer: what `forward` leaves for `backward`, and room for sums.
///
/// [`Layer::scratch`](crate::Layer::scratch) makes one. It starts on a cache line, because a load
/// that straddles two of them takes twice the time, and what lies in it does not depend on its
/// address: a clone made between `forward` and `backward` gives the same gradients. It remembers
/// the number of samples and the kind of layer that filled it, and `backward` of another layer
/// refuses it. Two layers with equal descriptions are not told apart.
pub struct Scratch<T> {
    values: Vec<T>,
    /// The first value on a cache line.
    start: usize,
    len: usize,
    /// The number of samples that the last `forward` had, and its layer's key; zeros where it left
    /// nothing.
    filled: (usize, u64),
}

impl<T: Real> Scratch<T> {
    /// Room for `len` values, all of them `value`: layers must not read what they did not write,
    /// and a test of that fills it with NaN.
    pub fn filled(len: usize, value: T) -> Scratch<T> {
        Scratch::aligned(len, value)
    }
}

impl<T> Scratch<T> {
    /// The number of values.
    pub fn len(&self) -> usize {
        self.len
    }

    /// `true` if it has no room, as for layers that need none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The first values.
    pub(crate) fn front(&mut self, len: usize) -> &mut [T] {
        &mut self.values[self.start..][..len]
    }

    /// The number of samples that the last `forward` had, and its layer's key.
    pub(crate) fn filled_by(&self) -> (usize, u64) {
        self.filled
    }

    pub(crate) fn set_filled(&mut self, samples: usize, key: u64) {
        self.filled = (samples, key);
    }
}

impl<T: Clone> Scratch<T> {
    fn aligned(len: usize, value: T) -> Scratch<T> {
        let values = vec![value; len + SLACK];
        Scratch {
            start: values.as_ptr().align_offset(LINE).min(SLACK),
            values,
            len,
            filled: (0, 0),
        }
    }
}

impl<T> fmt::Debug for Scratch<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Scratch({} values)", self.len)
    }
}

impl<T: Clone> Clone for Scratch<T> {
    fn clone(&self) -> Scratch<T> {
        let own = &self.values[self.start..][..self.len];
        let mut clone = Scratch::aligned(self.len, self.values[0].clone());
        clone.front(self.len).clone_from_slice(own);
        clone.filled = self.filled;
        clone
    }
}

/// The slices of [`Layer::backward`](crate::Layer::backward), of the right lengths.
///
/// The compiler knows that arguments do not overlap, but not that these fields do not. Loops over
/// them belong into functions that take them as arguments.
#[derive(Debug)]
pub struct BackwardPass<'a, T> {
    /// The parameters.
    pub params: &'a [T],
    /// The input, `[N, H, W, C]`.
    pub x: &'a [T],
    /// The output of the forward pass.
    pub y: &'a [T],
    /// The gradient in the output.
    pub dy: &'a [T],
    /// Memory for the gradient in the input, where it is wanted.
    pub dx: Option<&'a mut [T]>,
    /// Sum that the gradient in the parameters is added to.
    pub dparams: &'a mut [T],
    /// The scratch, as the forward pass left it where the layer keeps it.
    pub scratch: &'a mut [T],
}

/// The length rounded up to cache lines, so that what follows starts on one.
pub(crate) fn whole(len: usize) -> usize {
    len.next_multiple_of(SLACK)
}

/// Takes values off the front.
pub(crate) fn take_front<'a, T>(rest: &mut &'a mut [T], len: usize) -> &'a mut [T] {
    let (front, back) = std::mem::take(rest).split_at_mut(len);
    *rest = back;
    front
}

/// Takes values off the front, and what [`whole`] adds.
pub(crate) fn take_whole<'a, T>(rest: &mut &'a mut [T], len: usize) -> &'a mut [T] {
    &mut take_front(rest, whole(len))[..len]
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_scratch_starts_on_a_cache_line_and_clones_hold_the_same() {
        let mut starts = BTreeSet::new();
        for len in 0..100 {
            let mut scratch = Scratch::filled(len, 1.0f32);
            for (i, value) in scratch.front(len).iter_mut().enumerate() {
                *value = i as f32;
            }
            // what lies between them moves the clone to another offset
            let _between = vec![0u8; 8 * len + 8];
            let mut clone = scratch.clone();
            assert_eq!(clone.front(len), scratch.front(len));
            assert_eq!(clone.front(len).as_ptr() as usize % LINE, 0);
            assert_eq!(clone.len(), len);
            starts.extend([scratch.start, clone.start]);
        }
        assert!(starts.len() > 1, "all at one offset: {starts:?}");
        assert_eq!(Scratch::filled(9, 0.0f64).front(9).as_ptr() as usize % LINE, 0);
    }
}
