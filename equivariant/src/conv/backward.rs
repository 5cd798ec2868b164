//! The backward pass of a convolution over panels of folded patches.

use std::ops::Range;

use crate::conv::geometry::Conv;
use crate::conv::load::{Buffers, Loader, ROWS};
use crate::conv::maps::{Cursor, Maps, MapsMut};
use crate::conv::pass::Backward;
use crate::conv::pieces::Pieces;
use crate::real::Real;
use crate::simd::lanes::{Block, LANES, Lanes};
use crate::simd::lines::Lines;
use crate::simd::patches::Patches;
use crate::simd::tiles::{input, weights};

/// Rows of a tile of the input gradient.
const TILE: usize = 6;

/// The length of the scratch; `staged` says whether the input is.
pub(crate) fn scratch_len(conv: &Conv, samples: usize, staged: bool) -> usize {
    let (patches, width) = (&conv.patches, conv.weights.width());
    let images = if staged { 0 } else { 2 * conv.group(samples) };
    let of_lines = |lines: &Lines| lines.staged() + lines.columns() * width * LANES;
    let line = patches.lines().map_or(0, of_lines);
    Buffers::<f32>::scratch_len(conv) + images * patches.staged() + line
}

impl<T: Real> Backward<'_, T> {
    #[inline(always)]
    pub(crate) fn run_panels<L: Lanes<T>, const G: usize>(mut self, lanes: L) {
        let (conv, patches) = (self.conv, &self.conv.patches);
        let mut pieces = Pieces::new(std::mem::take(&mut self.scratch));
        let mut buffers = Buffers::new::<G>(&mut self, &mut pieces, ROWS);
        let loader = Loader::<T, L, G>::new(lanes, conv, self.dy, self.masks);
        let (together, own, own_gradient) = match self.x {
            Maps::Channels(_) => {
                let together = conv.group(self.samples);
                let len = patches.staged() * together;
                (together, pieces.flat_zeros(len), pieces.take_flat(len))
            }
            Maps::Staged(..) => (self.samples.max(1), Default::default(), Default::default()),
        };
        for first in (0..self.samples).step_by(together) {
            let images = together.min(self.samples - first);
            let staged = self.x.stage(lanes, patches, (first, images), own);
            let gradient = match &mut self.dx {
                None => None,
                Some(MapsMut::Channels(_)) => Some(&mut *own_gradient),
                Some(MapsMut::Staged(_, dx)) => Some(&mut **dx),
            };
            let panels = Panels {
                lanes,
                conv,
                staged,
                images: first..first + images,
            };
            panels.run::<G>(&loader, &mut buffers, gradient);
            if let Some(MapsMut::Channels(dx)) = &mut self.dx {
                unstage(
                    patches,
                    own_gradient,
                    &mut dx[first * patches.image().len()..],
                    images,
                );
            }
        }
        buffers.finish::<G>(conv);
    }
}

/// Brings staged images to channels.
#[inline(always)]
fn unstage<T: Real>(patches: &Patches, staged: &[T], dx: &mut [T], images: usize) {
    let staged = staged.chunks_exact(patches.staged());
    let dx = dx.chunks_exact_mut(patches.image().len());
    for (staged, dx) in staged.zip(dx).take(images) {
        patches.unstage(staged, dx);
    }
}

/// Staged images of which panels of folded patches are made.
struct Panels<'a, T, L> {
    lanes: L,
    conv: &'a Conv,
    staged: &'a [T],
    /// Which images of the pass they are.
    images: Range<usize>,
}

impl<T: Real, L: Lanes<T>> Panels<'_, T, L> {
    /// Adds what the images contribute; overwrites their gradient.
    #[inline(always)]
    fn run<const G: usize>(
        &self,
        loader: &Loader<T, L, G>,
        buffers: &mut Buffers<T>,
        mut gradient: Option<&mut [T]>,
    ) {
        let (patches, pixels) = (&self.conv.patches, loader.pixels);
        if let Some(gradient) = gradient.as_deref_mut() {
            gradient.fill(T::ZERO);
        }
        let mut cursor = Cursor::new(pixels);
        let end = self.images.end * pixels;
        for row in (self.images.start * pixels..end).step_by(ROWS) {
            let count = ROWS.min(end - row);
            let mut windows = [0; ROWS];
            for window in &mut windows[..count] {
                *window = cursor.at(patches.windows(), patches.staged());
                cursor.advance();
            }
            loader.run(row, count, buffers);
            self.gather::<G>(&windows[..count], buffers, gradient.as_deref_mut());
        }
    }

    /// Adds what some windows contribute.
    #[inline(always)]
    fn gather<const G: usize>(
        &self,
        windows: &[usize],
        buffers: &mut Buffers<T>,
        mut gradient: Option<&mut [T]>,
    ) {
        let (conv, patches) = (self.conv, &self.conv.patches);
        for c in 0..patches.blocks() {
            // what one orbit reads of a block of channels the next reads from the first-level cache
            for orbit in 0..patches.orbits() {
                let rows = Gathered {
                    conv,
                    orbit,
                    c,
                    windows,
                };
                let gradient = gradient.as_deref_mut();
                rows.run::<T, L, G>(self.lanes, self.staged, buffers, gradient);
            }
        }
    }
}

/// One orbit of taps of one block of channels of the windows of some rows.
struct Gathered<'a> {
    conv: &'a Conv,
    orbit: usize,
    c: usize,
    windows: &'a [usize],
}

impl Gathered<'_> {
    /// Adds what the rows contribute to the gradients of the weights and of the staged input.
    #[inline(always)]
    fn run<T: Real, L: Lanes<T>, const G: usize>(
        &self,
        lanes: L,
        staged: &[T],
        buffers: &mut Buffers<T>,
        gradient: Option<&mut [T]>,
    ) {
        let (patches, rows) = (&self.conv.patches, self.windows.len());
        let (blocks, width) = (patches.blocks(), self.conv.weights.width());
        let range = patches.folded_of(self.orbit);
        let folds = range.len() / blocks;
        let per_block = LANES / G * width;
        let dy = &buffers.dy[..width * rows];
        let panel = &mut buffers.panel[..folds * rows];
        patches.gather(
            lanes,
            (self.orbit, self.c),
            staged,
            self.windows,
            panel,
            rows,
        );
        let dw = &mut buffers.dw[(range.start + self.c) * per_block..];
        weights::<T, L, G>(lanes, panel, dy, rows, dw, blocks * per_block);
        let Some(gradient) = gradient else { return };
        let w = &buffers.w[range.start * per_block..][self.c * folds * per_block..];
        let w = &w[..folds * per_block];
        match (patches.replicated(), folds) {
            (true, _) => self.replicated::<T, L, G>(lanes, w, dy, gradient),
            (false, 1) => self.input::<T, L, G, 1>(lanes, w, dy, gradient),
            (false, 2) => self.input::<T, L, G, 2>(lanes, w, dy, gradient),
            (false, _) => self.input::<T, L, G, 4>(lanes, w, dy, gradient),
        }
    }

    #[inline(always)]
    fn input<T: Real, L: Lanes<T>, const G: usize, const N: usize>(
        &self,
        lanes: L,
        w: &[Block<T>],
        dy: &[Block<T>],
        gradient: &mut [T],
    ) {
        let mut row = 0;
        while row < self.windows.len() {
            if self.windows.len() - row >= TILE && L::REGISTERS >= 32 {
                self.tile::<T, L, G, TILE, N>(lanes, row, w, dy, gradient);
                row += TILE;
            } else if self.windows.len() - row >= 2 && L::REGISTERS >= 32 {
                self.tile::<T, L, G, 2, N>(lanes, row, w, dy, gradient);
                row += 2;
            } else {
                self.tile::<T, L, G, 1, N>(lanes, row, w, dy, gradient);
                row += 1;
            }
        }
    }

    #[inline(always)]
    fn tile<T: Real, L: Lanes<T>, const G: usize, const R: usize, const N: usize>(
        &self,
        lanes: L,
        row: usize,
        w: &[Block<T>],
        dy: &[Block<T>],
        gradient: &mut [T],
    ) {
        let folds = input::<T, L, G, R, N>(lanes, dy, self.windows.len(), row, w);
        let windows = &self.windows[row..];
        let patches = &self.conv.patches;
        patches.scatter::<T, L, R, N>(lanes, self.orbit, folds, gradient, windows, self.c);
    }

    #[inline(always)]
    fn replicated<T: Real, L: Lanes<T>, const G: usize>(
        &self,
        lanes: L,
        w: &[Block<T>],
        dy: &[Block<T>],
        gradient: &mut [T],
    ) {
        let patches = &self.conv.patches;
        for (row, &window) in self.windows.iter().enumerate() {
            let [[fold]] = input::<T, L, G, 1, 1>(lanes, dy, self.windows.len(), row, w);
            patches.scatter_replicated(lanes, self.orbit, fold, gradient, window + self.c * LANES);
        }
    }
}
