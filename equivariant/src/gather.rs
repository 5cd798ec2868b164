//! The fold of patches: the gather of a convolution, and its transpose.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over constants that index several arrays of registers"
)]

use crate::Scalar;
use crate::join::{head, head_mut};
use crate::lanes::{Block, LANES, Lanes};
use crate::patches::{Orbit, Patches};

impl Patches {
    /// Folds one orbit of the windows that start at `windows` into a panel `[block][row]`.
    #[inline(always)]
    pub fn gather<T: Scalar, L: Lanes<T>>(
        &self,
        lanes: L,
        orbit: usize,
        staged: &[T],
        windows: &[usize],
        panel: &mut [Block<T>],
    ) {
        let orbit = &self.orbits[orbit];
        match (self.replicated(), orbit.taps.len()) {
            (false, 1) => self.gather_orbit::<T, L, 1>(lanes, orbit, staged, windows, panel),
            (false, 2) => self.gather_orbit::<T, L, 2>(lanes, orbit, staged, windows, panel),
            (false, _) => self.gather_orbit::<T, L, 4>(lanes, orbit, staged, windows, panel),
            (true, 1) => self.gather_replicated::<T, L, 1>(lanes, orbit, staged, windows, panel),
            (true, 2) => self.gather_replicated::<T, L, 2>(lanes, orbit, staged, windows, panel),
            (true, _) => self.gather_replicated::<T, L, 4>(lanes, orbit, staged, windows, panel),
        }
    }

    #[inline(always)]
    fn gather_orbit<T: Scalar, L: Lanes<T>, const N: usize>(
        &self,
        lanes: L,
        orbit: &Orbit,
        staged: &[T],
        windows: &[usize],
        panel: &mut [Block<T>],
    ) {
        let rows = windows.len();
        let staged = staged.as_chunks().0;
        let scale = lanes.splat(T::from_f64(orbit.scale));
        let (mut taps, mut parities) = ([0; N], [0; N]);
        for i in 0..N {
            (taps[i], parities[i]) = (orbit.taps[i] / LANES, orbit.parities[i]);
        }
        for c in 0..self.blocks() {
            for (row, window) in windows.iter().enumerate() {
                let at = window / LANES + c;
                let mut values = [scale; N];
                for i in 0..N {
                    values[i] = lanes.load(&staged[at + taps[i]]);
                    if N < 4 {
                        values[i] = lanes.mul(values[i], scale);
                    }
                }
                values = butterfly(lanes, values);
                for i in 0..N {
                    // four folds have the four parities, and a constant is one instruction
                    let parity = if N == 4 { i } else { parities[i] };
                    let fold = swap(lanes, values[i], parity);
                    lanes.store(&mut panel[(i * self.blocks() + c) * rows + row], fold);
                }
            }
        }
    }

    #[inline(always)]
    fn gather_replicated<T: Scalar, L: Lanes<T>, const N: usize>(
        &self,
        lanes: L,
        orbit: &Orbit,
        staged: &[T],
        windows: &[usize],
        panel: &mut [Block<T>],
    ) {
        let rows = windows.len();
        let mut coefficients = [lanes.splat(T::ZERO); N];
        let mut taps = [0; N];
        for i in 0..N {
            taps[i] = orbit.taps[i];
            coefficients[i] = lanes.load(&narrow(&orbit.coefficients[i]));
        }
        for c in 0..self.blocks() {
            let panel = &mut panel[c * rows..][..rows];
            for (block, window) in panel.iter_mut().zip(windows) {
                let at = window + c * LANES;
                let mut sum = lanes.mul(lanes.load(head(&staged[at + taps[0]..])), coefficients[0]);
                for i in 1..N {
                    let x = lanes.load(head(&staged[at + taps[i]..]));
                    sum = lanes.mul_add(x, coefficients[i], sum);
                }
                lanes.store(block, sum);
            }
        }
    }

    /// The transpose of [`gather`](Patches::gather) for one row and block: adds the folds to the staged image.
    #[inline(always)]
    pub fn scatter<T: Scalar, L: Lanes<T>, const N: usize>(
        &self,
        lanes: L,
        orbit: usize,
        mut folds: [L::V; N],
        staged: &mut [T],
        at: usize,
    ) {
        let orbit = &self.orbits[orbit];
        let scale = lanes.splat(T::from_f64(orbit.scale));
        for i in 0..N {
            let parity = if N == 4 { i } else { orbit.parities[i] };
            folds[i] = swap(lanes, folds[i], parity);
            if N < 4 {
                folds[i] = lanes.mul(folds[i], scale);
            }
        }
        let values = butterfly(lanes, folds);
        for i in 0..N {
            let block = head_mut(&mut staged[at + orbit.taps[i]..]);
            let sum = lanes.add(lanes.load(block), values[i]);
            lanes.store(block, sum);
        }
    }

    #[inline(always)]
    pub fn scatter_replicated<T: Scalar, L: Lanes<T>>(
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
pub(crate) fn narrow<T: Scalar>(block: &Block<f64>) -> Block<T> {
    let mut narrow = [T::ZERO; LANES];
    for (to, &from) in narrow.iter_mut().zip(block) {
        *to = T::from_f64(from);
    }
    narrow
}

/// Lane i receives lane i xor parity; the four cases are constants for the instruction.
#[inline(always)]
fn swap<T: Scalar, L: Lanes<T>>(lanes: L, v: L::V, parity: usize) -> L::V {
    match parity {
        0 => v,
        1 => lanes.swap(v, 1),
        2 => lanes.swap(v, 2),
        _ => lanes.swap(v, 3),
    }
}

/// The Walsh-Hadamard transform without a factor.
#[inline(always)]
fn butterfly<T: Scalar, L: Lanes<T>, const N: usize>(lanes: L, mut v: [L::V; N]) -> [L::V; N] {
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
