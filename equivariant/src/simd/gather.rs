//! The fold of patches: the gather of a convolution, and its transpose.

use crate::real::Real;
use crate::simd::join::{head, head_mut};
use crate::simd::lanes::{Block, LANES, Lanes};
use crate::simd::patches::{Orbit, Patches};

impl Patches {
    /// Folds a block of one orbit of the windows that start at `windows` into panels of rows, one
    /// for each fold, `step` rows apart.
    #[inline(always)]
    pub fn gather<T: Real, L: Lanes<T>>(
        &self,
        lanes: L,
        (orbit, c): (usize, usize),
        staged: &[T],
        windows: &[usize],
        panels: &mut [Block<T>],
        step: usize,
    ) {
        let orbit = &self.orbits[orbit];
        if self.replicated() {
            let staged = &staged[c * LANES..];
            let panel = &mut panels[..windows.len()];
            return match orbit.taps.len() {
                1 => gather_replicated::<T, L, 1>(lanes, orbit, staged, windows, panel),
                // of the four taps of D2 the lines have folded two pairs
                _ => gather_replicated::<T, L, 2>(lanes, orbit, staged, windows, panel),
            };
        }
        let staged = &staged.as_chunks().0[c..];
        match orbit.taps.len() {
            1 => gather_orbit::<T, L, 1>(lanes, orbit, staged, windows, panels, step),
            2 => gather_orbit::<T, L, 2>(lanes, orbit, staged, windows, panels, step),
            _ => gather_orbit::<T, L, 4>(lanes, orbit, staged, windows, panels, step),
        }
    }

    /// The transpose of [`gather`](Patches::gather) for a block of the windows that start at
    /// `windows`: adds the folds to the staged image.
    #[inline(always)]
    pub fn scatter<T: Real, L: Lanes<T>, const R: usize, const N: usize>(
        &self,
        lanes: L,
        orbit: usize,
        folds: [[L::V; N]; R],
        staged: &mut [T],
        windows: &[usize],
        c: usize,
    ) {
        let orbit = &self.orbits[orbit];
        let staged: &mut [Block<T>] = staged.as_chunks_mut().0;
        let scale = lanes.splat(T::from_f64(orbit.scale));
        let (taps, parities) = orbit.constants::<N>();
        for (mut folds, window) in folds.into_iter().zip(windows) {
            for i in 0..N {
                let parity = if N == 4 { i } else { parities[i] };
                folds[i] = swap(lanes, folds[i], parity);
                if N < 4 {
                    folds[i] = lanes.mul(folds[i], scale);
                }
            }
            let values = butterfly(lanes, folds);
            let window = &mut staged[window / LANES + c..][..=taps[N - 1]];
            for i in 0..N {
                let block = &mut window[taps[i]];
                lanes.store(block, lanes.add(lanes.load(block), values[i]));
            }
        }
    }

    #[inline(always)]
    pub fn scatter_replicated<T: Real, L: Lanes<T>>(
        &self,
        lanes: L,
        orbit: usize,
        fold: L::V,
        staged: &mut [T],
        at: usize,
    ) {
        let orbit = &self.orbits[orbit];
        for (tap, coefficients) in orbit.taps.iter().zip(&orbit.coefficients) {
            let block = head_mut(&mut staged[at + tap..]);
            let c = lanes.load(&narrow(coefficients));
            let sum = lanes.mul_add(fold, c, lanes.load(block));
            lanes.store(block, sum);
        }
    }
}

#[inline(always)]
fn gather_orbit<T: Real, L: Lanes<T>, const N: usize>(
    lanes: L,
    orbit: &Orbit,
    staged: &[Block<T>],
    windows: &[usize],
    panels: &mut [Block<T>],
    step: usize,
) {
    let rows = windows.len();
    let scale = lanes.splat(T::from_f64(orbit.scale));
    let (taps, parities) = orbit.constants::<N>();
    // slices of equal lengths need one bounds check for all of them
    let len = staged.len() - taps[N - 1];
    let mut seen = [staged; N];
    let mut folds: [&mut [Block<T>]; N] = std::array::from_fn(|_| Default::default());
    let mut parts = panels.chunks_mut(step);
    for i in 0..N {
        seen[i] = &staged[taps[i]..][..len];
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
            // four folds have the four parities, and a constant is one instruction
            let parity = if N == 4 { i } else { parities[i] };
            let fold = swap(lanes, values[i], parity);
            lanes.store(&mut folds[i][row], fold);
        }
    }
}

#[inline(always)]
fn gather_replicated<T: Real, L: Lanes<T>, const N: usize>(
    lanes: L,
    orbit: &Orbit,
    staged: &[T],
    windows: &[usize],
    panel: &mut [Block<T>],
) {
    // the taps of a fold differ in signs alone, and a sum of signed values is that of its mirror
    let mut signs = [lanes.splat(T::ZERO); N];
    let mut taps = [0; N];
    for i in 0..N {
        taps[i] = orbit.taps[i];
        let signs_of_tap = orbit.coefficients[i].map(|c| if c == 0.0 { c } else { c.signum() });
        signs[i] = lanes.load(&narrow(&signs_of_tap));
    }
    let scale = lanes.load(&narrow(&orbit.coefficients[0].map(f64::abs)));
    for (block, &at) in panel.iter_mut().zip(windows) {
        let mut sum = lanes.mul(lanes.load(head(&staged[at + taps[0]..])), signs[0]);
        for i in 1..N {
            let x = lanes.load(head(&staged[at + taps[i]..]));
            sum = lanes.mul_add(x, signs[i], sum);
        }
        lanes.store(block, lanes.mul(sum, scale));
    }
}

impl Orbit {
    /// Places of the taps in a window, in blocks and in rising order, and the parities of the
    /// folds.
    #[inline(always)]
    fn constants<const N: usize>(&self) -> ([usize; N], [usize; N]) {
        let (mut taps, mut parities) = ([0; N], [0; N]);
        for i in 0..N {
            (taps[i], parities[i]) = (self.taps[i] / LANES, self.parities[i]);
        }
        (taps, parities)
    }
}

#[inline(always)]
pub(crate) fn narrow<T: Real>(block: &Block<f64>) -> Block<T> {
    let mut narrow = [T::ZERO; LANES];
    for (to, &from) in narrow.iter_mut().zip(block) {
        *to = T::from_f64(from);
    }
    narrow
}

/// Lane i receives lane i xor parity; the four cases are constants for the instruction.
#[inline(always)]
fn swap<T: Real, L: Lanes<T>>(lanes: L, v: L::V, parity: usize) -> L::V {
    match parity {
        0 => v,
        1 => lanes.swap(v, 1),
        2 => lanes.swap(v, 2),
        _ => lanes.swap(v, 3),
    }
}

/// The Walsh-Hadamard transform without a factor.
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
