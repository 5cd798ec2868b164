//! The backward pass of a convolution.

use crate::conv_forward::transform;
use crate::conv_lines::LINE;
use crate::join::Join;
use crate::lanes::{Block, Kernel, LANES, Lanes};
use crate::lines::Lines;
use crate::maps::{Cursor, Maps, MapsMut, Scratch, zeros};
use crate::tiles::{input, weights};
use crate::{R2Conv, Scalar};

/// Rows that are gathered at a time.
const ROWS: usize = 48;
/// Rows of a tile of the input gradient.
const TILE: usize = 6;

/// Everything that a backward pass reads and writes.
pub struct Backward<'a, T> {
    pub(crate) conv: &'a R2Conv,
    pub(crate) samples: usize,
    pub(crate) params: &'a [T],
    pub(crate) x: Maps<'a, T>,
    pub(crate) dy: Maps<'a, T>,
    /// Which values the ReLU of the forward pass let through; none for no ReLU.
    pub(crate) masks: Option<&'a [T]>,
    pub(crate) dx: Option<MapsMut<'a, T>>,
    pub(crate) dparams: &'a mut [T],
    pub(crate) scratch: &'a mut [T],
}

/// The buffers of a pass, in blocks.
pub(crate) struct Buffers<'a, T> {
    /// Transposed weights.
    w: &'a [Block<T>],
    /// The gradient of the packed weights.
    pub dw: &'a mut [Block<T>],
    /// That of the parameters, unless they are packed already and `dw` is the same.
    dweights: Option<&'a mut [T]>,
    dbias: &'a mut [Block<T>],
    dbiases: &'a mut [T],
    /// The output gradient of some rows, `[block][row]`.
    pub dy: &'a mut [Block<T>],
    /// Room for the same, `[row][block]`.
    pixels: &'a mut [Block<T>],
    /// The folds of one orbit and one block of channels for some rows, `[fold][row]`.
    panel: &'a mut [Block<T>],
}

impl<T: Scalar> Backward<'_, T> {
    /// The length of the scratch; `staged` says whether the input is.
    pub fn scratch_len(conv: &R2Conv, samples: usize, staged: bool) -> usize {
        let (patches, weights) = (conv.patches(), conv.weights());
        let images = if staged { 0 } else { 2 * conv.group(samples) };
        let panels = 4 * ROWS + 2 * LINE.max(ROWS) * weights.width();
        let rest = 3 * weights.blocks() + weights.width() + panels;
        let of_lines = |lines: &Lines| lines.staged() + lines.columns() * weights.width() * LANES;
        let line = patches.lines().map_or(0, of_lines);
        Scratch::<T>::len(rest) + images * patches.staged() + line
    }
}

impl<T: Scalar> Kernel<T> for Backward<'_, T> {
    #[inline(always)]
    fn run<L: Lanes<T>>(self, lanes: L) {
        if let (Some(lines), Maps::Channels(x), None) =
            (self.conv.patches().lines(), self.x, &self.dx)
        {
            return self.run_lines(lanes, lines, x);
        }
        match self.conv.weights().order() {
            1 => self.run_groups::<L, 1>(lanes),
            2 => self.run_groups::<L, 2>(lanes),
            _ => self.run_groups::<L, 4>(lanes),
        }
    }
}

impl<'a, T: Scalar> Backward<'a, T> {
    #[inline(always)]
    fn run_groups<L: Lanes<T>, const G: usize>(mut self, lanes: L) {
        let (conv, patches) = (self.conv, self.conv.patches());
        let mut scratch = Scratch::new(std::mem::take(&mut self.scratch));
        let mut buffers = self.buffers::<G>(&mut scratch, ROWS);
        let loader = Loader::<T, L, G>::new(lanes, conv, self.dy, self.masks);
        let together = match self.x {
            Maps::Channels(_) => conv.group(self.samples),
            Maps::Staged(..) => self.samples,
        };
        let (own, own_gradient) = match self.x {
            Maps::Channels(_) => {
                let len = patches.staged() * together;
                (zeros(scratch.take_flat(len)), scratch.take_flat(len))
            }
            Maps::Staged(..) => Default::default(),
        };
        for first in (0..self.samples).step_by(together) {
            let images = together.min(self.samples - first);
            let rows = images * loader.pixels;
            let staged = self.x.stage(lanes, patches, (first, images), own);
            let mut gradient = match &mut self.dx {
                None => None,
                Some(MapsMut::Channels(_)) => Some(&mut *own_gradient),
                Some(MapsMut::Staged(_, dx)) => Some(&mut **dx),
            };
            if let Some(gradient) = gradient.as_deref_mut() {
                gradient.fill(T::ZERO);
            }
            let mut cursor = Cursor::new(loader.pixels);
            for row in (0..rows).step_by(ROWS) {
                let count = ROWS.min(rows - row);
                let mut windows = [0; ROWS];
                for window in &mut windows[..count] {
                    *window = cursor.at(patches.windows(), patches.staged());
                    cursor.advance();
                }
                loader.run(first * loader.pixels + row, count, &mut buffers);
                for c in 0..patches.blocks() {
                    // what one orbit reads of a block of channels the next reads from the first-level cache
                    for orbit in 0..patches.orbits() {
                        let rows = Rows {
                            conv,
                            orbit,
                            c,
                            windows: &windows[..count],
                        };
                        rows.run::<T, L, G>(lanes, staged, &mut buffers, gradient.as_deref_mut());
                    }
                }
            }
            if let Some(MapsMut::Channels(dx)) = &mut self.dx {
                let len = patches.image().len();
                for i in 0..images {
                    let gradient = &own_gradient[i * patches.staged()..][..patches.staged()];
                    patches.unstage(gradient, &mut dx[(first + i) * len..][..len]);
                }
            }
        }
        buffers.finish::<G>(conv);
    }

    #[inline(always)]
    pub(crate) fn buffers<const G: usize>(
        &mut self,
        scratch: &mut Scratch<'a, T>,
        rows: usize,
    ) -> Buffers<'a, T> {
        let (conv, layout) = (self.conv, self.conv.weights());
        let width = layout.width();
        let w = scratch.take(layout.blocks());
        if self.dx.is_some() {
            let packed = layout.packed(self.params, scratch, true);
            layout.transpose::<T, G>(conv.patches(), packed, w);
        }
        let dparams = std::mem::take(&mut self.dparams);
        let (dweights, dbiases) = dparams.split_at_mut(conv.blocks().bias().start);
        let (dw, dweights) = if layout.in_place() {
            (&mut dweights.as_chunks_mut().0[..layout.blocks()], None)
        } else {
            (scratch.zeros(layout.blocks()), Some(dweights))
        };
        Buffers {
            w,
            dw,
            dweights,
            dbias: scratch.zeros(width),
            dbiases,
            pixels: scratch.zeros(rows * width),
            dy: scratch.take(rows * width),
            panel: scratch.take(ROWS * 4),
        }
    }
}

impl<T: Scalar> Buffers<'_, T> {
    /// Adds the gradients of the weights and of the bias to those of the parameters.
    pub fn finish<const G: usize>(self, conv: &R2Conv) {
        if let Some(dweights) = self.dweights {
            conv.weights().add_unpacked(self.dw, dweights);
        }
        let dbias = self.dbias.as_flattened().chunks_exact(G);
        for (d, group) in self.dbiases.iter_mut().zip(dbias) {
            *d += group[0];
        }
    }
}

/// Brings the output gradient into panels.
pub(crate) struct Loader<'a, T, L, const G: usize> {
    lanes: L,
    dy: Maps<'a, T>,
    masks: Option<&'a [T]>,
    join: Join,
    width: usize,
    pixels: usize,
    channels: usize,
    regular: bool,
}

impl<'a, T: Scalar, L: Lanes<T>, const G: usize> Loader<'a, T, L, G> {
    pub fn new(lanes: L, conv: &R2Conv, dy: Maps<'a, T>, masks: Option<&'a [T]>) -> Self {
        let shape = conv.shape_out();
        Loader {
            lanes,
            dy,
            masks,
            join: Join::new(shape.fields),
            width: conv.weights().width(),
            pixels: shape.pixels(),
            channels: shape.fields.dim(),
            regular: shape.fields.regular_fields().is_some(),
        }
    }

    /// Loads `count` pixels into a panel, back through the ReLU if there is one, and adds them to the gradient of the bias.
    #[inline(always)]
    pub fn run(&self, first: usize, count: usize, buffers: &mut Buffers<T>) {
        let width = self.width;
        let masks = self
            .masks
            .map(|masks| &masks[first * width..][..count * width]);
        let mut places = [0; LINE];
        let places = &mut places[..count];
        let (from, scale) = match self.dy {
            Maps::Channels(dy) => {
                let pixels = dy[first * self.channels..].chunks_exact(self.channels.max(1));
                let joined = buffers.pixels.chunks_exact_mut(width.max(1));
                for (r, ((place, to), dy)) in places.iter_mut().zip(joined).zip(pixels).enumerate()
                {
                    *place = r * width;
                    self.join
                        .run::<T, G>(T::from_f64(1.0), dy, to.as_flattened_mut());
                }
                (&*buffers.pixels, 1.0)
            }
            Maps::Staged(patches, dy) => {
                patches.places(first, places);
                (dy.as_chunks().0, patches.scale())
            }
        };
        let rows = Pixels {
            lanes: self.lanes,
            from,
            places,
            dbias: buffers.dbias,
        };
        match masks {
            None => rows.copy(scale, buffers.dy),
            Some(masks) if self.regular => rows.gate::<G>(masks, scale, buffers.dy),
            Some(masks) => rows.gate::<1>(masks, scale, buffers.dy),
        }
    }
}

/// Some pixels of the output gradient.
struct Pixels<'a, T, L> {
    lanes: L,
    from: &'a [Block<T>],
    /// Where the first block of every pixel lies.
    places: &'a [usize],
    dbias: &'a mut [Block<T>],
}

impl<T: Scalar, L: Lanes<T>> Pixels<'_, T, L> {
    #[inline(always)]
    fn copy(self, scale: f64, panel: &mut [Block<T>]) {
        let (lanes, rows) = (self.lanes, self.places.len());
        let scale = lanes.splat(T::from_f64(scale));
        for (c, dbias) in self.dbias.iter_mut().enumerate() {
            let mut sum = lanes.load(dbias);
            let panel = &mut panel[c * rows..][..rows];
            for (to, place) in panel.iter_mut().zip(self.places) {
                let v = lanes.mul(lanes.load(&self.from[place + c]), scale);
                sum = lanes.add(sum, v);
                lanes.store(to, v);
            }
            lanes.store(dbias, sum);
        }
    }

    /// Lets through what the ReLU let through, in the basis that the group permutes.
    #[inline(always)]
    fn gate<const G: usize>(self, masks: &[T], scale: f64, panel: &mut [Block<T>]) {
        let (lanes, rows, width) = (self.lanes, self.places.len(), self.dbias.len());
        let masks = &masks[..rows * width];
        let scale = lanes.splat(T::from_f64(scale / G as f64));
        for (c, dbias) in self.dbias.iter_mut().enumerate() {
            let mut sum = lanes.load(dbias);
            let panel = &mut panel[c * rows..][..rows];
            for (r, (to, place)) in panel.iter_mut().zip(self.places).enumerate() {
                let v = transform::<T, L, G>(lanes, lanes.load(&self.from[place + c]));
                let v = lanes.keep(v, masks[r * width + c].to_mask());
                let v = lanes.mul(transform::<T, L, G>(lanes, v), scale);
                sum = lanes.add(sum, v);
                lanes.store(to, v);
            }
            lanes.store(dbias, sum);
        }
    }
}

/// One orbit of taps of one block of channels of the windows of some rows.
struct Rows<'a> {
    conv: &'a R2Conv,
    orbit: usize,
    c: usize,
    windows: &'a [usize],
}

impl Rows<'_> {
    /// Adds what the rows contribute to the gradients of the weights and of the staged input.
    #[inline(always)]
    fn run<T: Scalar, L: Lanes<T>, const G: usize>(
        &self,
        lanes: L,
        staged: &[T],
        buffers: &mut Buffers<T>,
        gradient: Option<&mut [T]>,
    ) {
        let (patches, rows) = (self.conv.patches(), self.windows.len());
        let (blocks, width) = (patches.blocks(), self.conv.weights().width());
        let range = patches.folded_of(self.orbit);
        let folds = range.len() / blocks.max(1);
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
    fn input<T: Scalar, L: Lanes<T>, const G: usize, const N: usize>(
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
    fn tile<T: Scalar, L: Lanes<T>, const G: usize, const R: usize, const N: usize>(
        &self,
        lanes: L,
        row: usize,
        w: &[Block<T>],
        dy: &[Block<T>],
        gradient: &mut [T],
    ) {
        let folds = input::<T, L, G, R, N>(lanes, dy, self.windows.len(), row, w);
        let windows = &self.windows[row..];
        let patches = self.conv.patches();
        patches.scatter::<T, L, R, N>(lanes, self.orbit, folds, gradient, windows, self.c);
    }

    #[inline(always)]
    fn replicated<T: Scalar, L: Lanes<T>, const G: usize>(
        &self,
        lanes: L,
        w: &[Block<T>],
        dy: &[Block<T>],
        gradient: &mut [T],
    ) {
        let patches = self.conv.patches();
        for (row, &window) in self.windows.iter().enumerate() {
            let [[fold]] = input::<T, L, G, 1, 1>(lanes, dy, self.windows.len(), row, w);
            patches.scatter_replicated(lanes, self.orbit, fold, gradient, window + self.c * LANES);
        }
    }
}
