//! Fold of im2col patches into signed sums over orbits of taps: the gather step of a convolution,
//! and its transpose.

use crate::real::Real;
use crate::simd::interleave::{first_n, first_n_mut};
use crate::simd::lanes::{Block, LANES, Lanes};
use crate::simd::patches::{PatchGeometry, TapOrbit};

/// Indices of an orbit of taps and of the block of channels in which it is folded.
#[derive(Clone, Copy)]
pub(crate) struct OrbitBlock {
    pub orbit: usize,
    pub block: usize,
}

impl PatchGeometry {
    /// Folds one orbit of taps in one block of channels into signed sums, for the windows that
    /// start at `windows`. There is a panel with a row per window for each fold, and `step` rows
    /// from one panel to the next.
    #[inline(always)]
    pub fn gather_signed_tap_sums<T: Real, L: Lanes<T>>(
        &self,
        lanes: L,
        fold: OrbitBlock,
        blocked: &[T],
        windows: &[usize],
        panels: &mut [Block<T>],
        step: usize,
    ) {
        let orbit = &self.orbits[fold.orbit];
        if self.is_replicated {
            let blocked = &blocked[fold.block * LANES..];
            let panel = &mut panels[..windows.len()];
            return match orbit.tap_offsets.len() {
                1 => gather_replicated::<T, L, 1>(lanes, orbit, blocked, windows, panel),
                // an orbit of D2 has up to four taps, of which the lines fold two pairs already
                _ => gather_replicated::<T, L, 2>(lanes, orbit, blocked, windows, panel),
            };
        }
        let blocked = &blocked.as_chunks().0[fold.block..];
        match orbit.tap_offsets.len() {
            1 => gather_orbit::<T, L, 1>(lanes, orbit, blocked, windows, panels, step),
            2 => gather_orbit::<T, L, 2>(lanes, orbit, blocked, windows, panels, step),
            _ => gather_orbit::<T, L, 4>(lanes, orbit, blocked, windows, panels, step),
        }
    }

    /// Adds the gradients of folds, the signed sums over an orbit of taps, to the pixels of a block
    /// of channels in the windows that start at `windows`: the transpose of
    /// [`PatchGeometry::gather_signed_tap_sums`].
    #[inline(always)]
    pub fn scatter_tap_sum_gradients<T: Real, L: Lanes<T>, const R: usize, const N: usize>(
        &self,
        lanes: L,
        orbit: usize,
        folds: [[L::V; N]; R],
        blocked: &mut [T],
        windows: &[usize],
        c: usize,
    ) {
        let orbit = &self.orbits[orbit];
        let blocked: &mut [Block<T>] = blocked.as_chunks_mut().0;
        let scale = lanes.splat(T::from_f64(orbit.scale));
        let (taps, parities) = orbit.tap_offsets_and_parities::<N>();
        for (mut sums, window) in folds.into_iter().zip(windows) {
            for i in 0..N {
                let parity = if N == 4 { i } else { parities[i] };
                sums[i] = swap_lanes(lanes, sums[i], parity);
                if N < 4 {
                    sums[i] = lanes.mul(sums[i], scale);
                }
            }
            let values = butterfly(lanes, sums);
            let window = &mut blocked[window / LANES + c..][..=taps[N - 1]];
            for i in 0..N {
                let block = &mut window[taps[i]];
                lanes.store(block, lanes.add(lanes.load(block), values[i]));
            }
        }
    }

    /// Adds the gradient of the fold of replicated channels to the window that starts at `at`.
    #[inline(always)]
    pub fn scatter_replicated_gradient<T: Real, L: Lanes<T>>(
        &self,
        lanes: L,
        orbit: usize,
        fold: L::V,
        blocked: &mut [T],
        at: usize,
    ) {
        let orbit = &self.orbits[orbit];
        for (tap, coefficients) in orbit.tap_offsets.iter().zip(&orbit.coefficients) {
            let block = first_n_mut(&mut blocked[at + tap..]);
            let c = lanes.load(&block_to_precision(coefficients));
            let sum = lanes.mul_add(fold, c, lanes.load(block));
            lanes.store(block, sum);
        }
    }
}

/// Folds an orbit of N taps into signed sums, for the windows that start at `windows`.
#[inline(always)]
fn gather_orbit<T: Real, L: Lanes<T>, const N: usize>(
    lanes: L,
    orbit: &TapOrbit,
    blocked: &[Block<T>],
    windows: &[usize],
    panels: &mut [Block<T>],
    step: usize,
) {
    let rows = windows.len();
    let scale = lanes.splat(T::from_f64(orbit.scale));
    let (taps, parities) = orbit.tap_offsets_and_parities::<N>();
    // slices of equal lengths need one bounds check for all of them
    let len = blocked.len() - taps[N - 1];
    let mut seen = [blocked; N];
    let mut folds: [&mut [Block<T>]; N] = std::array::from_fn(|_| Default::default());
    let mut parts = panels.chunks_mut(step);
    for i in 0..N {
        seen[i] = &blocked[taps[i]..][..len];
        folds[i] = &mut parts.next().unwrap_or_default()[..rows];
    }
    for (row, window) in windows.iter().enumerate() {
        let at = window / LANES;
        let mut values = [scale; N];
        for i in 0..N {
            values[i] = lanes.load(&seen[i][at]);
            if N < 4 {
                values[i] = lanes.mul(values[i], scale);
            }
        }
        values = butterfly(lanes, values);
        for i in 0..N {
            // Four folds have the four parities in order, and a constant parity is one instruction.
            let parity = if N == 4 { i } else { parities[i] };
            let fold = swap_lanes(lanes, values[i], parity);
            lanes.store(&mut folds[i][row], fold);
        }
    }
}

/// Folds an orbit of N taps of replicated channels into signed sums, for the windows that start at
/// `windows`.
#[inline(always)]
fn gather_replicated<T: Real, L: Lanes<T>, const N: usize>(
    lanes: L,
    orbit: &TapOrbit,
    blocked: &[T],
    windows: &[usize],
    panel: &mut [Block<T>],
) {
    // The taps of a fold differ in signs only. Signed values sum to the same bits under a flip;
    // products with coefficients would not.
    let mut signs = [lanes.splat(T::ZERO); N];
    let mut taps = [0; N];
    for i in 0..N {
        taps[i] = orbit.tap_offsets[i];
        let signs_of_tap = orbit.coefficients[i].map(|c| if c == 0.0 { c } else { c.signum() });
        signs[i] = lanes.load(&block_to_precision(&signs_of_tap));
    }
    let scale = lanes.load(&block_to_precision(&orbit.coefficients[0].map(f64::abs)));
    for (block, &at) in panel.iter_mut().zip(windows) {
        let mut sum = lanes.mul(lanes.load(first_n(&blocked[at + taps[0]..])), signs[0]);
        for i in 1..N {
            let x = lanes.load(first_n(&blocked[at + taps[i]..]));
            sum = lanes.mul_add(x, signs[i], sum);
        }
        lanes.store(block, lanes.mul(sum, scale));
    }
}

impl TapOrbit {
    /// Returns the offsets of the orbit's taps in a window, in blocks and ascending, and the
    /// parities of its folds.
    #[inline(always)]
    fn tap_offsets_and_parities<const N: usize>(&self) -> ([usize; N], [usize; N]) {
        let (mut taps, mut parities) = ([0; N], [0; N]);
        for i in 0..N {
            (taps[i], parities[i]) = (self.tap_offsets[i] / LANES, self.parities[i]);
        }
        (taps, parities)
    }
}

/// Converts a block of double-precision numbers to the precision `T`.
#[inline(always)]
pub(crate) fn block_to_precision<T: Real>(block: &Block<f64>) -> Block<T> {
    let mut narrow = [T::ZERO; LANES];
    for (to, &from) in narrow.iter_mut().zip(block) {
        *to = T::from_f64(from);
    }
    narrow
}

/// Swaps lanes: lane i receives lane i xor `parity`. Each case is a constant of the instruction.
#[inline(always)]
fn swap_lanes<T: Real, L: Lanes<T>>(lanes: L, v: L::V, parity: usize) -> L::V {
    match parity {
        0 => v,
        1 => lanes.swap_lanes(v, 1),
        2 => lanes.swap_lanes(v, 2),
        _ => lanes.swap_lanes(v, 3),
    }
}

/// Returns the Walsh-Hadamard transform of N vectors, lane by lane, without its factor 1/sqrt(N).
#[inline(always)]
fn butterfly<T: Real, L: Lanes<T>, const N: usize>(lanes: L, mut v: [L::V; N]) -> [L::V; N] {
    let mut step = 1;
    while step < N {
        for i in 0..N {
            if i & step == 0 {
                let (a, b) = (v[i], v[i + step]);
                v[i] = lanes.add(a, b);
                v[i + step] = lanes.sub(a, b);
            }
        }
        step *= 2;
    }
    v
}
