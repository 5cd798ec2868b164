//! Memory that the passes of a layer read and write.

use std::fmt;

/// Bytes of a cache line of the CPU; every scratch memory starts on one.
const CACHE_LINE_BYTES: usize = 64;
/// Number of values of the narrowest type, `f32`, in a cache line: at most as many are skipped to
/// reach one.
const VALUES_PER_LINE: usize = CACHE_LINE_BYTES / size_of::<f32>();

/// Memory for the passes of a layer: values that `forward` saves for `backward`, and working space.
///
/// [`Layer::allocate_scratch`](crate::Layer::allocate_scratch) creates one. It starts on a cache
/// line, because a load that straddles two of them takes twice the time. Its contents do not depend
/// on its address: a clone made between `forward` and `backward` gives the same gradients. It
/// records the number of samples and the kind of layer that filled it, and `backward` of another
/// layer rejects it. Two layers with equal descriptions count as the same layer.
pub struct Scratch<T> {
    values: Vec<T>,
    /// Index of the first value used, which starts a cache line.
    start: usize,
    len: usize,
    pub(crate) origin: ScratchOrigin,
}

/// Identity of the forward pass that filled a scratch memory, by which `backward` recognises its
/// own; the default if no pass saved values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ScratchOrigin {
    /// Number of samples of the forward pass that filled the scratch memory.
    pub samples: usize,
    /// [`scratch_key`](crate::LayerSignature::scratch_key) of the layer that filled the scratch
    /// memory.
    pub layer_key: u64,
}

impl<T> Scratch<T> {
    /// Returns the number of values that this scratch memory holds.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Returns `true` if the scratch memory holds no values, as for layers that need none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Returns the first `len` values of the scratch memory.
    pub(crate) fn first_values(&mut self, len: usize) -> &mut [T] {
        &mut self.values[self.start..][..len]
    }
}

impl<T: Clone> Scratch<T> {
    /// Creates scratch memory of `len` values, all equal to `value`. Layers must not read what they
    /// did not write; a test fills the memory with NaN to check that.
    pub fn new_filled(len: usize, value: T) -> Scratch<T> {
        let values = vec![value; len + VALUES_PER_LINE];
        Scratch {
            // align_offset may give up and return usize::MAX, which min turns into a valid start
            start: values.as_ptr().align_offset(CACHE_LINE_BYTES).min(VALUES_PER_LINE),
            values,
            len,
            origin: ScratchOrigin::default(),
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
        // the clone's vector has another address and so another offset: copy the values, not the
        // vector
        let mut clone = Scratch::new_filled(self.len, self.values[0].clone());
        clone.first_values(self.len).clone_from_slice(own);
        clone.origin = self.origin;
        clone
    }
}

/// Arguments of [`Layer::backward`](crate::Layer::backward): slices whose lengths have been
/// checked.
///
/// The compiler knows that arguments of a function do not overlap, but not that these fields do
/// not. So put loops over them into functions that take the slices as arguments.
#[derive(Debug)]
pub struct BackwardArgs<'a, T> {
    /// Parameters of the layer.
    pub params: &'a [T],
    /// Input of the forward pass, `[N, H, W, C]` (samples, height, width, channels).
    pub x: &'a [T],
    /// Output of the forward pass, `[N, H, W, C]` (samples, height, width, channels).
    pub y: &'a [T],
    /// Gradient of the loss with respect to the output `y`, in the shape of `y`.
    pub dy: &'a [T],
    /// Buffer for the gradient with respect to the input `x`, in the shape of `x`; `None` if the
    /// gradient is not needed.
    pub dx: Option<&'a mut [T]>,
    /// Buffer to which the gradient with respect to the parameters is added.
    pub dparams: &'a mut [T],
    /// Scratch memory; holds the values that the forward pass saved if the layer keeps them.
    pub scratch: &'a mut [T],
}

/// Rounds the length of a part of a scratch memory up to whole cache lines, so that the next part
/// starts on one.
pub(crate) fn round_up_to_cache_line(len: usize) -> usize {
    len.next_multiple_of(VALUES_PER_LINE)
}

/// Splits `len` values off the front of a slice.
pub(crate) fn take_front<'a, T>(rest: &mut &'a mut [T], len: usize) -> &'a mut [T] {
    let (front, back) = std::mem::take(rest).split_at_mut(len);
    *rest = back;
    front
}

/// Splits `len` values off the front of a slice and drops the padding that
/// [`round_up_to_cache_line`] adds.
pub(crate) fn take_front_padded<'a, T>(rest: &mut &'a mut [T], len: usize) -> &'a mut [T] {
    &mut take_front(rest, round_up_to_cache_line(len))[..len]
}

/// Splits `len` values off the back of a slice and drops the padding that
/// [`round_up_to_cache_line`] adds.
pub(crate) fn take_back_padded<'a, T>(rest: &mut &'a mut [T], len: usize) -> &'a mut [T] {
    let at = rest.len() - round_up_to_cache_line(len);
    let (front, back) = std::mem::take(rest).split_at_mut(at);
    *rest = front;
    &mut back[..len]
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_scratch_starts_on_a_cache_line_and_clones_hold_the_same() {
        let mut starts = BTreeSet::new();
        for len in 0..100 {
            let mut scratch = Scratch::new_filled(len, 1.0f32);
            for (i, value) in scratch.first_values(len).iter_mut().enumerate() {
                *value = i as f32;
            }
            // an allocation in between moves the clone to another offset
            let _between = vec![0u8; 8 * len + 8];
            let mut clone = scratch.clone();
            assert_eq!(clone.first_values(len), scratch.first_values(len));
            assert_eq!(clone.first_values(len).as_ptr() as usize % CACHE_LINE_BYTES, 0);
            assert_eq!(clone.len(), len);
            starts.extend([scratch.start, clone.start]);
        }
        assert!(starts.len() > 1, "all at one offset: {starts:?}");
        assert_eq!(
            Scratch::new_filled(9, 0.0f64).first_values(9).as_ptr() as usize % CACHE_LINE_BYTES,
            0
        );
    }
}
