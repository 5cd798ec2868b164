//! The forward pass of a convolution.

use crate::join::Join;
use crate::lanes::{Block, Kernel, LANES, Lanes};
use crate::lines::Lines;
use crate::maps::{Cursor, Maps, MapsMut, Scratch, zeros};
use crate::tiles::{ROWS, forward};
use crate::{R2Conv, Scalar};

/// Everything that a forward pass reads and writes.
pub struct Forward<'a, T> {
    pub(crate) conv: &'a R2Conv,
    pub(crate) samples: usize,
    pub(crate) params: &'a [T],
    pub(crate) x: Maps<'a, T>,
    pub(crate) y: MapsMut<'a, T>,
    /// Where to keep which values a ReLU passes, a number for every block of outputs; none for no ReLU.
    pub(crate) masks: Option<&'a mut [T]>,
    pub(crate) scratch: &'a mut [T],
}

impl<T: Scalar> Forward<'_, T> {
    /// The length of the scratch; `staged` says whether the input is.
    pub fn scratch_len(conv: &R2Conv, samples: usize, staged: bool) -> usize {
        let (patches, weights) = (conv.patches(), conv.weights());
        let images = if staged { 0 } else { conv.group(samples) };
        let per_row = patches.folded() + weights.width();
        let rest = weights.packed() + 2 * weights.width() + ROWS * per_row;
        let line = patches.lines().map_or(0, Lines::staged);
        Scratch::<T>::len(rest) + images * patches.staged() + line
    }
}

impl<T: Scalar> Kernel<T> for Forward<'_, T> {
    #[inline(always)]
    fn run<L: Lanes<T>>(self, lanes: L) {
        if let (Some(lines), Maps::Channels(x)) = (self.conv.patches().lines(), self.x) {
            return self.run_lines(lanes, lines, x);
        }
        match self.conv.weights().order() {
            1 => self.run_groups::<L, 1>(lanes),
            2 => self.run_groups::<L, 2>(lanes),
            _ => self.run_groups::<L, 4>(lanes),
        }
    }
}

impl<T: Scalar> Forward<'_, T> {
    #[inline(always)]
    fn run_groups<L: Lanes<T>, const G: usize>(self, lanes: L) {
        let (conv, patches, weights) = (self.conv, self.conv.patches(), self.conv.weights());
        let mut scratch = Scratch::new(self.scratch);
        let w = scratch.take(weights.packed());
        weights.pack(self.params, w);
        let biases = &self.params[conv.blocks().bias()];
        let mut finish =
            Finish::<T, L, G>::new(lanes, conv, biases, &mut scratch, self.masks, self.y);
        let panel = scratch.take(ROWS * patches.folded());
        let sums = scratch.take(ROWS * weights.width());
        let together = match self.x {
            Maps::Channels(_) => conv.group(self.samples),
            Maps::Staged(..) => self.samples,
        };
        let own = match self.x {
            Maps::Channels(_) => zeros(scratch.take_flat(patches.staged() * together)),
            Maps::Staged(..) => Default::default(),
        };
        for first in (0..self.samples).step_by(together) {
            let images = together.min(self.samples - first);
            let rows = images * finish.pixels;
            let staged = self.x.stage(lanes, patches, (first, images), own);
            let mut cursor = Cursor::new(finish.pixels);
            for row in (0..rows).step_by(ROWS) {
                let count = ROWS.min(rows - row);
                let mut windows = [0; ROWS];
                let mut places = [(0, 0); ROWS];
                for r in 0..ROWS {
                    // an incomplete block ends with copies of its last row
                    windows[r] = cursor.at(patches.windows(), patches.staged());
                    places[r] = (first + cursor.image, cursor.pixel);
                    if r + 1 < count {
                        cursor.advance();
                    }
                }
                cursor.advance();
                for orbit in 0..patches.orbits() {
                    let range = patches.folded_of(orbit);
                    let panel = &mut panel[range.start * ROWS..range.end * ROWS];
                    patches.gather(lanes, orbit, staged, &windows, panel);
                }
                forward::<T, L, G>(lanes, panel.as_chunks().0, w, sums, count);
                for (sums, &place) in sums.chunks_exact(finish.width.max(1)).zip(&places[..count]) {
                    finish.run(sums, place);
                }
            }
        }
    }
}

/// What happens to the sums of an output pixel.
pub(crate) struct Finish<'a, T, L, const G: usize> {
    lanes: L,
    width: usize,
    join: Join,
    pixels: usize,
    channels: usize,
    regular: bool,
    bias: &'a [Block<T>],
    /// Room for a pixel.
    own: &'a mut [Block<T>],
    masks: Option<&'a mut [T]>,
    y: MapsMut<'a, T>,
}

impl<'a, T: Scalar, L: Lanes<T>, const G: usize> Finish<'a, T, L, G> {
    #[inline(always)]
    pub fn new(
        lanes: L,
        conv: &R2Conv,
        biases: &[T],
        scratch: &mut Scratch<'a, T>,
        masks: Option<&'a mut [T]>,
        y: MapsMut<'a, T>,
    ) -> Self {
        let shape = conv.shape_out();
        let width = conv.weights().width();
        let bias = scratch.zeros(width);
        for (group, &b) in bias.as_flattened_mut().chunks_exact_mut(G).zip(biases) {
            group[0] = b;
        }
        Finish {
            lanes,
            width,
            join: Join::new(shape.fields),
            pixels: shape.pixels(),
            channels: shape.fields.dim(),
            regular: shape.fields.regular_fields().is_some(),
            bias,
            own: scratch.take(width),
            masks,
            y,
        }
    }

    /// Adds the bias, rectifies if there are masks, and writes the pixel of the image.
    #[inline(always)]
    pub fn run(&mut self, sums: &[Block<T>], (image, pixel): (usize, usize)) {
        let (to, scale) = match &mut self.y {
            MapsMut::Channels(_) => (&mut *self.own, 1.0),
            MapsMut::Staged(patches, y) => {
                let at = image * patches.staged() + patches.pixels()[pixel];
                let y = y[at..][..self.width * LANES].as_chunks_mut().0;
                (y, patches.scale())
            }
        };
        let first = (image * self.pixels + pixel) * self.width;
        let masks = self.masks.as_deref_mut();
        let masks = masks.map(|masks| &mut masks[first..][..self.width]);
        match masks {
            Some(masks) if self.regular => {
                rectify::<T, L, G>(self.lanes, sums, self.bias, masks, scale, to)
            }
            Some(masks) => rectify::<T, L, 1>(self.lanes, sums, self.bias, masks, scale, to),
            None => add_bias(self.lanes, sums, self.bias, scale, to),
        }
        if let MapsMut::Channels(y) = &mut self.y {
            let y = &mut y[(image * self.pixels + pixel) * self.channels..][..self.channels];
            self.join
                .undo::<T, G>(T::from_f64(1.0), self.own.as_flattened(), y);
        }
    }
}

#[inline(always)]
fn add_bias<T: Scalar, L: Lanes<T>>(
    lanes: L,
    sums: &[Block<T>],
    bias: &[Block<T>],
    scale: f64,
    to: &mut [Block<T>],
) {
    let scale = lanes.splat(T::from_f64(scale));
    for ((sum, bias), to) in sums.iter().zip(bias).zip(to) {
        let v = lanes.add(lanes.load(sum), lanes.load(bias));
        lanes.store(to, lanes.mul(v, scale));
    }
}

/// Adds the bias and rectifies in the basis that the group permutes.
#[inline(always)]
fn rectify<T: Scalar, L: Lanes<T>, const G: usize>(
    lanes: L,
    sums: &[Block<T>],
    bias: &[Block<T>],
    masks: &mut [T],
    scale: f64,
    to: &mut [Block<T>],
) {
    let scale = lanes.splat(T::from_f64(scale / G as f64));
    for (((sum, bias), mask), to) in sums.iter().zip(bias).zip(masks).zip(to) {
        let v = lanes.add(lanes.load(sum), lanes.load(bias));
        let (v, bits) = lanes.rectify(transform::<T, L, G>(lanes, v));
        *mask = T::from_mask(bits);
        lanes.store(to, lanes.mul(transform::<T, L, G>(lanes, v), scale));
    }
}

/// The Walsh-Hadamard transform within groups of lanes, without its factor 1/sqrt(G).
#[inline(always)]
pub(crate) fn transform<T: Scalar, L: Lanes<T>, const G: usize>(lanes: L, mut v: L::V) -> L::V {
    if G > 1 {
        v = lanes.mul_add(v, signs(lanes, 1), lanes.swap(v, 1));
    }
    if G > 2 {
        v = lanes.mul_add(v, signs(lanes, 2), lanes.swap(v, 2));
    }
    v
}

#[inline(always)]
fn signs<T: Scalar, L: Lanes<T>>(lanes: L, bit: usize) -> L::V {
    let mut signs = [T::from_f64(1.0); LANES];
    for (lane, sign) in signs.iter_mut().enumerate() {
        if lane & bit != 0 {
            *sign = T::from_f64(-1.0);
        }
    }
    lanes.load(&signs)
}
