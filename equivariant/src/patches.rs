//! Images laid out for the kernels, and the fold of their patches.
//!
//! Read this before editing. The *staged* image is padded with zeros and holds the channels of a pixel
//! field by field: G lanes per field, one for each irrep. The fold of an orbit of taps then is a butterfly
//! over a few blocks, and its result of parity p goes from input irrep a = b p to output irrep b by a swap of
//! lanes within the groups. A *panel* holds the folded patches of some rows (output pixels), `[block][row]`.
//!
//! Trivial channels would leave most lanes empty. They are staged as G copies, and the lanes of a folded
//! group are the parities of one orbit, since parity b is what leads from the trivial irrep to irrep b.

use symmetry::Irrep;

use crate::join::Join;
use crate::lanes::{Block, LANES, Lanes};
use crate::taps::Taps;
use crate::{Kernel, Scalar, Shape};

/// The geometry of staged images and of the fold.
#[derive(Clone, Debug)]
pub(crate) struct Patches {
    image: Shape,
    kernel: Kernel,
    /// Where the window of every output pixel starts in a staged image, in blocks.
    windows: Vec<usize>,
    /// Where every pixel of the image lies in a staged image, in blocks.
    pixels: Vec<usize>,
    /// Blocks of a staged pixel.
    blocks: usize,
    replicated: bool,
    orbits: Vec<Orbit>,
    /// Blocks of a folded patch.
    folded: usize,
}

/// The taps {g t}, folded together.
#[derive(Clone, Debug)]
struct Orbit {
    /// Where the taps lie in a window, in blocks.
    taps: Vec<usize>,
    /// The parities of the folds, as positions in the group's list of irreps.
    parities: Vec<usize>,
    /// The first block of the folds in a patch.
    first: usize,
    /// The factor that makes the fold orthonormal, given staged values over sqrt(G).
    scale: f64,
    /// For replicated channels: the coefficient of each tap in each lane.
    coefficients: Vec<Block<f64>>,
}

impl Patches {
    pub fn new(taps: &Taps, image: Shape, kernel: Kernel, out_size: [usize; 2]) -> Patches {
        let group = image.fields.group();
        let irreps = group.irreps().iter();
        let fields = irreps.map(|&a| image.fields.multiplicity(a)).max();
        let mut patches = Patches {
            image,
            kernel,
            windows: Vec::new(),
            pixels: Vec::new(),
            blocks: (fields.unwrap_or(0) * group.order()).div_ceil(LANES),
            replicated: image.fields.is_trivial() && group.order() > 1,
            orbits: Vec::new(),
            folded: 0,
        };
        patches.windows = patches.offsets(out_size, kernel.stride, 0);
        patches.pixels = patches.offsets([image.height, image.width], 1, kernel.padding);
        for function in taps.functions() {
            patches.add(taps, function.parts[0].0);
        }
        patches
    }

    /// The offsets of a grid of pixels in a staged image, in blocks.
    fn offsets(&self, [height, width]: [usize; 2], step: usize, first: usize) -> Vec<usize> {
        let at = |y, x| (first + y * step) * self.staged_width() + first + x * step;
        let lines = (0..height).flat_map(|y| (0..width).map(move |x| (y, x)));
        lines.map(|(y, x)| at(y, x) * self.blocks).collect()
    }

    /// Adds the orbit that starts with this tap, unless it is there.
    fn add(&mut self, taps: &Taps, start: [usize; 2]) {
        let offset = |[y, x]: [usize; 2]| (y * self.staged_width() + x) * self.blocks;
        if self.orbits.iter().any(|o| o.taps[0] == offset(start)) {
            return;
        }
        let group = self.image.fields.group();
        let functions = taps.functions().iter().filter(|f| f.parts[0].0 == start);
        let functions: Vec<_> = functions.collect();
        let position = |p: Irrep| group.irreps().iter().position(|&a| a == p).unwrap_or(0);
        let parities: Vec<usize> = functions.iter().map(|f| position(f.parity)).collect();
        let parts = &functions[0].parts;
        let coefficients = (0..parts.len()).map(|tap| {
            std::array::from_fn(|lane| {
                let of_lane = parities.iter().position(|&p| p == lane % group.order());
                of_lane.map_or(0.0, |i| functions[i].parts[tap].1)
            })
        });
        let orbit = Orbit {
            taps: parts.iter().map(|part| offset(part.0)).collect(),
            first: self.folded,
            scale: (group.order() as f64 / parts.len() as f64).sqrt(),
            coefficients: coefficients.collect(),
            parities,
        };
        self.folded += self.blocks * if self.replicated { 1 } else { parts.len() };
        self.orbits.push(orbit);
    }

    pub fn image(&self) -> Shape {
        self.image
    }

    pub fn kernel(&self) -> Kernel {
        self.kernel
    }

    pub fn orbits(&self) -> usize {
        self.orbits.len()
    }

    /// Blocks of a folded patch.
    pub fn folded(&self) -> usize {
        self.folded
    }

    /// Blocks of a folded patch that come from one orbit.
    pub fn folded_of(&self, orbit: usize) -> std::ops::Range<usize> {
        let next = self.orbits.get(orbit + 1).map_or(self.folded, |o| o.first);
        self.orbits[orbit].first..next
    }

    /// The first group of lanes of a folded patch that holds the channels of a function on the taps.
    pub fn first_group(&self, parity: Irrep, start: [usize; 2]) -> usize {
        let offset = (start[0] * self.staged_width() + start[1]) * self.blocks;
        let group = self.image.fields.group();
        let per_block = LANES / group.order();
        for orbit in &self.orbits {
            if orbit.taps[0] == offset {
                let i = orbit.parities.iter().position(|&p| group.irreps()[p] == parity);
                let skipped = if self.replicated { 0 } else { i.unwrap_or(0) };
                return (orbit.first + skipped * self.blocks) * per_block;
            }
        }
        unreachable!("every function starts with the first tap of an orbit")
    }

    fn staged_width(&self) -> usize {
        self.image.width + 2 * self.kernel.padding
    }

    /// Blocks of a staged image.
    pub fn staged(&self) -> usize {
        (self.image.height + 2 * self.kernel.padding) * self.staged_width() * self.blocks
    }

    /// Where the window of every output pixel starts in a staged image, in blocks.
    pub fn windows(&self) -> &[usize] {
        &self.windows
    }

    /// Where every pixel of the image lies in a staged image, in blocks.
    pub fn pixels(&self) -> &[usize] {
        &self.pixels
    }

    /// The factor of staged values, which orbits of G taps then need no other to be orthonormal.
    pub fn scale(&self) -> f64 {
        (self.image.fields.group().order() as f64).sqrt().recip()
    }

    /// Writes zeros around an image.
    pub fn clear_border<T: Scalar>(&self, staged: &mut [Block<T>]) {
        let line = self.image.width * self.blocks;
        let mut end = 0;
        for &start in self.pixels.iter().step_by(self.image.width.max(1)) {
            staged[end..start].as_flattened_mut().fill(T::ZERO);
            end = start + line;
        }
        staged[end..].as_flattened_mut().fill(T::ZERO);
    }

    /// Stages one image; padding and lanes without a channel must be zero and stay so.
    #[inline(always)]
    pub fn stage<T: Scalar>(&self, image: &[T], staged: &mut [Block<T>]) {
        match self.image.fields.group().order() {
            1 => self.stage_groups::<T, 1>(image, staged),
            2 => self.stage_groups::<T, 2>(image, staged),
            _ => self.stage_groups::<T, 4>(image, staged),
        }
    }

    #[inline(always)]
    fn stage_groups<T: Scalar, const G: usize>(&self, image: &[T], staged: &mut [Block<T>]) {
        let channels = self.image.fields.dim();
        let scale = T::from_f64(self.scale());
        let join = Join::new(self.image.fields);
        for (i, &to) in self.pixels.iter().enumerate() {
            let from = &image[i * channels..][..channels];
            let to = staged[to..][..self.blocks].as_flattened_mut();
            if self.replicated {
                replicate::<T, G>(from, to);
            } else {
                join.run::<T, G>(scale, from, to);
            }
        }
    }

    /// The transpose of [`stage`](Patches::stage): overwrites one image.
    #[inline(always)]
    pub fn unstage<T: Scalar>(&self, staged: &[Block<T>], image: &mut [T]) {
        match self.image.fields.group().order() {
            1 => self.unstage_groups::<T, 1>(staged, image),
            2 => self.unstage_groups::<T, 2>(staged, image),
            _ => self.unstage_groups::<T, 4>(staged, image),
        }
    }

    #[inline(always)]
    fn unstage_groups<T: Scalar, const G: usize>(&self, staged: &[Block<T>], image: &mut [T]) {
        let channels = self.image.fields.dim();
        let scale = T::from_f64(self.scale());
        let join = Join::new(self.image.fields);
        for (i, &from) in self.pixels.iter().enumerate() {
            let to = &mut image[i * channels..][..channels];
            let from = staged[from..][..self.blocks].as_flattened();
            if self.replicated {
                add_up::<T, G>(from, to);
            } else {
                join.undo::<T, G>(scale, from, to);
            }
        }
    }
}

#[inline(always)]
fn replicate<T: Scalar, const G: usize>(channels: &[T], groups: &mut [T]) {
    for (group, &x) in groups.as_chunks_mut::<G>().0.iter_mut().zip(channels) {
        *group = [x; G];
    }
}

#[inline(always)]
fn add_up<T: Scalar, const G: usize>(groups: &[T], channels: &mut [T]) {
    for (group, x) in groups.as_chunks::<G>().0.iter().zip(channels) {
        let mut sum = group[0];
        for &copy in &group[1..] {
            sum += copy;
        }
        *x = sum;
    }
}

impl Patches {
    /// Folds one orbit of the windows that start at `windows` into a panel `[block][row]`.
    #[inline(always)]
    pub fn gather<T: Scalar, L: Lanes<T>>(
        &self,
        lanes: L,
        orbit: usize,
        staged: &[Block<T>],
        windows: &[usize],
        panel: &mut [Block<T>],
    ) {
        let orbit = &self.orbits[orbit];
        if self.replicated {
            return self.gather_replicated(lanes, orbit, staged, windows, panel);
        }
        match orbit.taps.len() {
            1 => self.gather_orbit::<T, L, 1>(lanes, orbit, staged, windows, panel),
            2 => self.gather_orbit::<T, L, 2>(lanes, orbit, staged, windows, panel),
            _ => self.gather_orbit::<T, L, 4>(lanes, orbit, staged, windows, panel),
        }
    }

    #[inline(always)]
    fn gather_orbit<T: Scalar, L: Lanes<T>, const N: usize>(
        &self,
        lanes: L,
        orbit: &Orbit,
        staged: &[Block<T>],
        windows: &[usize],
        panel: &mut [Block<T>],
    ) {
        let (blocks, rows) = (self.blocks, windows.len());
        let mut parts = panel.chunks_exact_mut(blocks * rows);
        let parts: [&mut [Block<T>]; N] =
            std::array::from_fn(|_| parts.next().unwrap_or_default());
        let scale = lanes.splat(T::from_f64(orbit.scale));
        for (row, &window) in windows.iter().enumerate() {
            let taps: [&[Block<T>]; N] =
                std::array::from_fn(|i| &staged[window + orbit.taps[i]..][..blocks]);
            for c in 0..blocks {
                let mut values = [lanes.splat(T::ZERO); N];
                for i in 0..N {
                    values[i] = lanes.load(&taps[i][c]);
                    if N < 4 {
                        values[i] = lanes.mul(values[i], scale);
                    }
                }
                let folds = butterfly(lanes, values);
                for i in 0..N {
                    let fold = swap(lanes, folds[i], orbit.parities[i]);
                    lanes.store(&mut parts[i][c * rows + row], fold);
                }
            }
        }
    }

    #[inline(always)]
    fn gather_replicated<T: Scalar, L: Lanes<T>>(
        &self,
        lanes: L,
        orbit: &Orbit,
        staged: &[Block<T>],
        windows: &[usize],
        panel: &mut [Block<T>],
    ) {
        let (blocks, rows) = (self.blocks, windows.len());
        let n = orbit.taps.len();
        let mut coefficients = [lanes.splat(T::ZERO); 4];
        for (c, of_tap) in coefficients.iter_mut().zip(&orbit.coefficients) {
            *c = lanes.load(&of_tap.map(T::from_f64));
        }
        for (row, &window) in windows.iter().enumerate() {
            for c in 0..blocks {
                let mut sum = lanes.splat(T::ZERO);
                for i in 0..n {
                    let x = lanes.load(&staged[window + orbit.taps[i] + c]);
                    sum = lanes.mul_add(x, coefficients[i], sum);
                }
                lanes.store(&mut panel[c * rows + row], sum);
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
        staged: &mut [Block<T>],
        at: usize,
    ) {
        let orbit = &self.orbits[orbit];
        let scale = lanes.splat(T::from_f64(orbit.scale));
        for i in 0..N {
            folds[i] = swap(lanes, folds[i], orbit.parities[i]);
            if N < 4 {
                folds[i] = lanes.mul(folds[i], scale);
            }
        }
        let values = butterfly(lanes, folds);
        for i in 0..N {
            let block = &mut staged[at + orbit.taps[i]];
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
        staged: &mut [Block<T>],
        at: usize,
    ) {
        let orbit = &self.orbits[orbit];
        for (tap, coefficients) in orbit.taps.iter().zip(&orbit.coefficients) {
            let block = &mut staged[at + tap];
            let c = lanes.load(&coefficients.map(T::from_f64));
            let sum = lanes.mul_add(fold, c, lanes.load(block));
            lanes.store(block, sum);
        }
    }

    /// Blocks of a staged pixel.
    pub fn blocks(&self) -> usize {
        self.blocks
    }

    pub fn replicated(&self) -> bool {
        self.replicated
    }

    pub fn orbit_len(&self, orbit: usize) -> usize {
        self.orbits[orbit].taps.len()
    }
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
