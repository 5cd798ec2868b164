//! Conversion between irrep-major channels and lane groups, with a lane for each irrep.

use symmetry::FieldType;

use crate::real::Real;

/// Conversion between the irrep-major channels of a pixel and lane groups, one for each field with
/// a lane for each irrep.
#[derive(Clone, Debug)]
pub(crate) struct Interleaver {
    /// Number of regular fields of a pixel; `None` if the field type has other channels.
    regular: Option<usize>,
    /// First channel and number of channels of each irrep.
    irrep_channels: [(usize, usize); 4],
}

impl Interleaver {
    pub fn new(fields: FieldType) -> Interleaver {
        let mut irrep_channels = [(0, 0); 4];
        for (channels, &irrep) in irrep_channels.iter_mut().zip(fields.group().irreps()) {
            let range = fields.channel_range(irrep);
            *channels = (range.start, range.len());
        }
        Interleaver { regular: fields.num_regular_fields(), irrep_channels }
    }

    /// Writes the scaled channels of a pixel into its lane groups, one for each field; lanes
    /// without a channel stay unchanged.
    ///
    /// Never inlined: otherwise kernels test at every pixel whether the slices overlap, even if
    /// they do not interleave anything.
    #[inline(never)]
    pub fn interleave<T: Real, const G: usize>(&self, scale: T, channels: &[T], groups: &mut [T]) {
        let groups = groups.as_chunks_mut::<G>().0;
        match self.regular {
            // constant widths let the compiler interleave whole registers
            Some(n) if n % 16 == 0 => interleave_regular::<T, G, 16>(n, scale, channels, groups),
            Some(n) if n % 4 == 0 => interleave_regular::<T, G, 4>(n, scale, channels, groups),
            _ => {
                for (lane, &(start, len)) in self.irrep_channels[..G].iter().enumerate() {
                    for (group, &x) in groups.iter_mut().zip(&channels[start..start + len]) {
                        group[lane] = x * scale;
                    }
                }
            }
        }
    }

    /// Writes the scaled lanes of a pixel's lane groups into its irrep-major channels. Never
    /// inlined, like [`interleave`](Interleaver::interleave).
    #[inline(never)]
    pub fn deinterleave_channels<T: Real, const G: usize>(
        &self,
        scale: T,
        groups: &[T],
        channels: &mut [T],
    ) {
        let groups = groups.as_chunks::<G>().0;
        match self.regular {
            Some(n) if n % 16 == 0 => deinterleave_regular::<T, G, 16>(n, scale, groups, channels),
            Some(n) if n % 4 == 0 => deinterleave_regular::<T, G, 4>(n, scale, groups, channels),
            _ => {
                for (lane, &(start, len)) in self.irrep_channels[..G].iter().enumerate() {
                    for (group, x) in groups.iter().zip(&mut channels[start..start + len]) {
                        *x = group[lane] * scale;
                    }
                }
            }
        }
    }
}

/// Interleaves the channels of n regular fields into lane groups, N fields at a time.
#[inline(always)]
fn interleave_regular<T: Real, const G: usize, const N: usize>(
    n: usize,
    scale: T,
    channels: &[T],
    groups: &mut [[T; G]],
) {
    for (i, block) in groups[..n].as_chunks_mut::<N>().0.iter_mut().enumerate() {
        for a in 0..G {
            let part: &[T; N] = first_n(&channels[a * n + i * N..]);
            for f in 0..N {
                block[f][a] = part[f] * scale;
            }
        }
    }
}

/// Writes the lane groups of n regular fields as irrep-major channels, N fields at a time.
#[inline(always)]
fn deinterleave_regular<T: Real, const G: usize, const N: usize>(
    n: usize,
    scale: T,
    groups: &[[T; G]],
    channels: &mut [T],
) {
    for (i, block) in groups[..n].as_chunks::<N>().0.iter().enumerate() {
        for a in 0..G {
            let part = &mut channels[a * n + i * N..][..N];
            for f in 0..N {
                part[f] = block[f][a] * scale;
            }
        }
    }
}

/// Returns the first N values of a slice as an array.
#[inline(always)]
pub(crate) fn first_n<V, const N: usize>(values: &[V]) -> &[V; N] {
    match values.first_chunk() {
        Some(head) => head,
        None => unreachable!("the operands have the sizes of the layer"),
    }
}

/// Returns the first N values of a slice as a mutable array.
#[inline(always)]
pub(crate) fn first_n_mut<V, const N: usize>(values: &mut [V]) -> &mut [V; N] {
    match values.first_chunk_mut() {
        Some(head) => head,
        None => unreachable!("the operands have the sizes of the layer"),
    }
}
