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
const ROWS: usize = 24;
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
    pub dw: &'a mut [Block<T>],
    dbias: &'a mut [Block<T>],
    /// The output gradient of some rows, `[block][row]`.
    pub dy: &'a mut [Block<T>],
    /// One row of it.
    pixel: &'a mut [Block<T>],
    /// One orbit of the folded patches of some rows, `[block][row]`.
    panel: &'a mut [Block<T>],
}

impl<T: Scalar> Backward<'_, T> {
    /// The length of the scratch; `staged` says whether the input is.
    pub fn scratch_len(conv: &R2Conv, samples: usize, staged: bool) -> usize {
        let (patches, weights) = (conv.patches(), conv.weights());
        let images = if staged { 0 } else { 2 * conv.group(samples) };
        let panels = 4 * ROWS * patches.blocks() + LINE.max(ROWS) * weights.width();
        let rest = 3 * weights.packed() + 2 * weights.width() + panels;
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

impl<T: Scalar> Backward<'_, T> {
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
                for (r, window) in windows[..count].iter_mut().enumerate() {
                    *window = cursor.at(patches.windows(), patches.staged());
                    let place = (first + cursor.image, cursor.pixel);
                    loader.run(place, r, count, &mut buffers);
                    cursor.advance();
                }
                loader.bias(count, &mut buffers);
                for orbit in 0..patches.orbits() {
                    let rows = Rows {
                        conv,
                        orbit,
                        windows: &windows[..count],
                    };
                    rows.run::<T, L, G>(lanes, staged, &mut buffers, gradient.as_deref_mut());
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
        add_gradients::<T, G>(conv, &buffers, self.dparams);
    }

    #[inline(always)]
    pub(crate) fn buffers<'b, const G: usize>(
        &self,
        scratch: &mut Scratch<'b, T>,
        rows: usize,
    ) -> Buffers<'b, T> {
        let (patches, layout) = (self.conv.patches(), self.conv.weights());
        let width = layout.width();
        let w = scratch.take(layout.packed());
        if self.dx.is_some() {
            let packed = scratch.take(layout.packed());
            layout.pack(self.params, packed);
            layout.transpose::<T, G>(patches, packed, w);
        }
        Buffers {
            w,
            dw: scratch.zeros(layout.packed()),
            dbias: scratch.zeros(width),
            pixel: scratch.zeros(width),
            dy: scratch.take(rows * width),
            panel: scratch.take(ROWS * 4 * patches.blocks()),
        }
    }
}

/// Adds the gradients of the weights and of the bias to those of the parameters.
pub(crate) fn add_gradients<T: Scalar, const G: usize>(
    conv: &R2Conv,
    buffers: &Buffers<T>,
    dparams: &mut [T],
) {
    conv.weights().add_unpacked(buffers.dw, dparams);
    let dbias = buffers.dbias.as_flattened().chunks_exact(G);
    for (d, group) in dparams[conv.blocks().bias()].iter_mut().zip(dbias) {
        *d += group[0];
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

    /// Loads one pixel into row `r` of the panel of `rows` rows, back through the ReLU if there is one.
    #[inline(always)]
    pub fn run(
        &self,
        (image, pixel): (usize, usize),
        r: usize,
        rows: usize,
        buffers: &mut Buffers<T>,
    ) {
        let Buffers {
            dy: panel,
            pixel: channels,
            ..
        } = buffers;
        let (from, scale) = match self.dy {
            Maps::Channels(dy) => {
                let first = (image * self.pixels + pixel) * self.channels;
                let dy = &dy[first..][..self.channels];
                self.join
                    .run::<T, G>(T::from_f64(1.0), dy, channels.as_flattened_mut());
                (&**channels, 1.0)
            }
            Maps::Staged(patches, dy) => {
                let at = image * patches.staged() + patches.pixels()[pixel];
                (
                    dy[at..][..self.width * LANES].as_chunks().0,
                    patches.scale(),
                )
            }
        };
        let first = (image * self.pixels + pixel) * self.width;
        let masks = self.masks.map(|masks| &masks[first..][..self.width]);
        for c in 0..self.width {
            let v = self.lanes.load(&from[c]);
            let v = match masks {
                None => self.lanes.mul(v, self.lanes.splat(T::from_f64(scale))),
                Some(masks) if self.regular => gate::<T, L, G>(self.lanes, v, masks[c], scale),
                Some(masks) => gate::<T, L, 1>(self.lanes, v, masks[c], scale),
            };
            self.lanes.store(&mut panel[c * rows + r], v);
        }
    }

    /// Adds a panel of `rows` rows to the gradient of the bias.
    #[inline(always)]
    pub fn bias(&self, rows: usize, buffers: &mut Buffers<T>) {
        let panels = buffers.dy.chunks_exact(rows);
        for (sum, panel) in buffers.dbias.iter_mut().zip(panels) {
            let mut v = self.lanes.load(sum);
            for row in panel {
                v = self.lanes.add(v, self.lanes.load(row));
            }
            self.lanes.store(sum, v);
        }
    }
}

/// Lets through what the ReLU let through, in the basis that the group permutes.
#[inline(always)]
fn gate<T: Scalar, L: Lanes<T>, const G: usize>(lanes: L, v: L::V, mask: T, scale: f64) -> L::V {
    let bits = mask.to_mask();
    let v = lanes.keep(transform::<T, L, G>(lanes, v), bits);
    let scale = lanes.splat(T::from_f64(scale / G as f64));
    lanes.mul(transform::<T, L, G>(lanes, v), scale)
}

/// One orbit of taps of the windows of some rows.
struct Rows<'a> {
    conv: &'a R2Conv,
    orbit: usize,
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
        let width = self.conv.weights().width();
        let range = patches.folded_of(self.orbit);
        let per_block = LANES / G * width;
        let panel = &mut buffers.panel[..range.len() * rows];
        patches.gather(lanes, self.orbit, staged, self.windows, panel);
        let packed = range.start * per_block..range.end * per_block;
        let dy = &buffers.dy[..width * rows];
        weights::<T, L, G>(lanes, panel, dy, rows, &mut buffers.dw[packed.clone()]);
        let Some(gradient) = gradient else { return };
        let w = &buffers.w[packed];
        match (patches.replicated(), patches.orbit_len(self.orbit)) {
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
        let blocks = self.conv.patches().blocks();
        for (c, w) in w.chunks_exact((w.len() / blocks).max(1)).enumerate() {
            let mut row = 0;
            while row < self.windows.len() {
                if self.windows.len() - row >= TILE && L::REGISTERS >= 32 {
                    self.tile::<T, L, G, TILE, N>(lanes, (row, c), w, dy, gradient);
                    row += TILE;
                } else if self.windows.len() - row >= 2 && L::REGISTERS >= 32 {
                    self.tile::<T, L, G, 2, N>(lanes, (row, c), w, dy, gradient);
                    row += 2;
                } else {
                    self.tile::<T, L, G, 1, N>(lanes, (row, c), w, dy, gradient);
                    row += 1;
                }
            }
        }
    }

    #[inline(always)]
    fn tile<T: Scalar, L: Lanes<T>, const G: usize, const R: usize, const N: usize>(
        &self,
        lanes: L,
        (row, c): (usize, usize),
        w: &[Block<T>],
        dy: &[Block<T>],
        gradient: &mut [T],
    ) {
        let folds = input::<T, L, G, R, N>(lanes, dy, self.windows.len(), row, w);
        let windows = &self.windows[row..];
        let patches = self.conv.patches();
        patches.scatter::<T, L, R, N>(lanes, self.orbit, folds, gradient, windows, c);
    }

    #[inline(always)]
    fn replicated<T: Scalar, L: Lanes<T>, const G: usize>(
        &self,
        lanes: L,
        w: &[Block<T>],
        dy: &[Block<T>],
        gradient: &mut [T],
    ) {
        let blocks = self.conv.patches().blocks();
        for (c, w) in w.chunks_exact((w.len() / blocks).max(1)).enumerate() {
            for (row, &window) in self.windows.iter().enumerate() {
                let [[fold]] = input::<T, L, G, 1, 1>(lanes, dy, self.windows.len(), row, w);
                let patches = self.conv.patches();
                patches.scatter_replicated(lanes, self.orbit, fold, gradient, window + c * LANES);
            }
        }
    }
}
