//! Between irrep-major channels and groups of lanes.

use symmetry::FieldType;

use crate::real::Real;

/// Which channels of a pixel go to which lane of the groups.
#[derive(Clone, Debug)]
pub(crate) struct Join {
    /// The number of regular fields, if there is nothing else.
    regular: Option<usize>,
    /// The first channel of each irrep and their number.
    parts: [(usize, usize); 4],
}

impl Join {
    pub fn new(fields: FieldType) -> Join {
        let mut parts = [(0, 0); 4];
        for (part, &irrep) in parts.iter_mut().zip(fields.group().irreps()) {
            let range = fields.range(irrep);
            *part = (range.start, range.len());
        }
        Join { regular: fields.regular_fields(), parts }
    }

    /// Writes the channels of a pixel, scaled, into the groups; lanes without a channel stay as
    /// they are.
    ///
    /// Never inlined: a kernel would test at every pixel whether the slices overlap, even where it
    /// joins nothing.
    #[inline(never)]
    pub fn run<T: Real, const G: usize>(&self, scale: T, channels: &[T], groups: &mut [T]) {
        let groups = groups.as_chunks_mut::<G>().0;
        match self.regular {
            // constant widths let the compiler interleave whole registers
            Some(n) if n % 16 == 0 => join_regular::<T, G, 16>(n, scale, channels, groups),
            Some(n) if n % 4 == 0 => join_regular::<T, G, 4>(n, scale, channels, groups),
            _ => {
                for (lane, &(start, len)) in self.parts[..G].iter().enumerate() {
                    for (group, &x) in groups.iter_mut().zip(&channels[start..start + len]) {
                        group[lane] = x * scale;
                    }
                }
            }
        }
    }

    /// Writes the lanes of the groups, scaled, into the channels of a pixel; never inlined for the
    /// same reason.
    #[inline(never)]
    pub fn undo<T: Real, const G: usize>(&self, scale: T, groups: &[T], channels: &mut [T]) {
        let groups = groups.as_chunks::<G>().0;
        match self.regular {
            Some(n) if n % 16 == 0 => part_regular::<T, G, 16>(n, scale, groups, channels),
            Some(n) if n % 4 == 0 => part_regular::<T, G, 4>(n, scale, groups, channels),
            _ => {
                for (lane, &(start, len)) in self.parts[..G].iter().enumerate() {
                    for (group, x) in groups.iter().zip(&mut channels[start..start + len]) {
                        *x = group[lane] * scale;
                    }
                }
            }
        }
    }
}

#[inline(always)]
fn join_regular<T: Real, const G: usize, const N: usize>(
    n: usize,
    scale: T,
    channels: &[T],
    groups: &mut [[T; G]],
) {
    for (i, groups) in groups[..n].as_chunks_mut::<N>().0.iter_mut().enumerate() {
        for a in 0..G {
            let part: &[T; N] = head(&channels[a * n + i * N..]);
            for f in 0..N {
                groups[f][a] = part[f] * scale;
            }
        }
    }
}

#[inline(always)]
fn part_regular<T: Real, const G: usize, const N: usize>(
    n: usize,
    scale: T,
    groups: &[[T; G]],
    channels: &mut [T],
) {
    for (i, groups) in groups[..n].as_chunks::<N>().0.iter().enumerate() {
        for a in 0..G {
            let part = &mut channels[a * n + i * N..][..N];
            for f in 0..N {
                part[f] = groups[f][a] * scale;
            }
        }
    }
}

/// The first N values.
#[inline(always)]
pub(crate) fn head<V, const N: usize>(values: &[V]) -> &[V; N] {
    match values.first_chunk() {
        Some(head) => head,
        None => unreachable!("the operands have the sizes of the layer"),
    }
}

/// The first N values, to be written.
#[inline(always)]
pub(crate) fn head_mut<V, const N: usize>(values: &mut [V]) -> &mut [V; N] {
    match values.first_chunk_mut() {
        Some(head) => head,
        None => unreachable!("the operands have the sizes of the layer"),
    }
}
