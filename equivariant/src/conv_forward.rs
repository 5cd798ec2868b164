//! The forward pass of a convolution.

use std::ops::Range;

use crate::chunks::in_one_of_many_chunks;
use crate::join::Join;
use crate::lanes::{Block, Kernel, LANES, Lanes};
use crate::lines::Lines;
use crate::maps::{Cursor, Maps, MapsMut, Scratch, zeros};
use crate::tiles::{ROWS, forward};
use crate::{R2Conv, Scalar};

/// Rows up to which a forward pass reads parameters in place: to copy them to cache lines pays when they are read often.
const IN_PLACE: usize = 2 * ROWS;

/// Multiplications from which on half of them are worth another thread, which takes microseconds to get.
const SPLIT: usize = 1 << 18;

/// Everything that a forward pass reads and writes.
pub struct Forward<'a, T> {
    pub(crate) conv: &'a R2Conv,
    pub(crate) samples: usize,
    pub(crate) params: &'a [T],
    pub(crate) x: Maps<'a, T>,
    pub(crate) to: Output<'a, T>,
    pub(crate) scratch: &'a mut [T],
}

/// What a forward pass writes.
pub(crate) struct Output<'a, T> {
    /// Which lines of the output; all of them unless there is one sample. `y` and `masks` begin with the first.
    pub lines: Range<usize>,
    pub y: MapsMut<'a, T>,
    /// Where to keep which values a ReLU passes, a number for every block of outputs; none for no ReLU.
    pub masks: Option<&'a mut [T]>,
}

impl<T: Scalar> Forward<'_, T> {
    /// The length of the scratch, also of two halves of a single image; `staged` says whether the input is.
    pub fn scratch_len(conv: &R2Conv, samples: usize, staged: bool) -> usize {
        let (patches, weights) = (conv.patches(), conv.weights());
        let per_row = patches.folded() + weights.width();
        let rest = weights.blocks() + (ROWS + 1) * weights.width() + ROWS * per_row;
        let line = patches.lines().map_or(0, Lines::staged);
        let with = |images| Scratch::<T>::len(rest) + images * patches.staged() + line;
        match staged {
            true => 2 * with(0),
            false => with(conv.group(samples)).max(2 * with(1)),
        }
    }

    /// Runs the pass: that of a single image in two halves, which have the same bits, if a thread of the current rayon pool may be
    /// free for one of them.
    pub fn run_on_threads(self) {
        let products = self.conv.shape_out().pixels() * self.conv.weights().blocks() * LANES;
        let worth = self.samples == 1 && self.conv.shape_out().height > 1 && products >= SPLIT;
        let threads = match rayon::current_thread_index() {
            Some(_) if !in_one_of_many_chunks() => rayon::current_num_threads(),
            _ => 1,
        };
        if worth && threads > 1 {
            let (above, below) = self.halves();
            rayon::join(|| T::forward(above), || T::forward(below));
        } else {
            T::forward(self);
        }
    }

    /// The pass over the upper and that over the lower lines of a single image.
    fn halves(self) -> (Self, Self) {
        let (above, below) = self.to.halves(self.conv);
        let (scratch, scratch_below) = self.scratch.split_at_mut(self.scratch.len() / 2);
        let above = Forward {
            to: above,
            scratch,
            ..self
        };
        let below = Forward {
            to: below,
            scratch: scratch_below,
            ..above
        };
        (above, below)
    }
}

impl<T: Scalar> Output<'_, T> {
    /// The upper and the lower lines of a single image.
    fn halves(self, conv: &R2Conv) -> (Self, Self) {
        let shape = conv.shape_out();
        let middle = shape.height / 2;
        let pixels = middle * shape.width;
        let (y, y_below) = self.y.split(pixels, shape.fields.dim());
        let at = pixels * conv.weights().width();
        let (masks, masks_below) = self.masks.map(|masks| masks.split_at_mut(at)).unzip();
        let above = Output {
            lines: 0..middle,
            y,
            masks,
        };
        let below = Output {
            lines: middle..shape.height,
            y: y_below,
            masks: masks_below,
        };
        (above, below)
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
        let width = conv.shape_out().width;
        let lines = &self.to.lines;
        let pixels = &patches.windows()[lines.start * width..lines.end * width];
        let few = self.samples * pixels.len() <= IN_PLACE;
        let w = weights.packed(self.params, &mut scratch, few);
        let mut finish = Finish::<T, L, G>::new(lanes, conv, self.params, &mut scratch, self.to);
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
            let rows = images * pixels.len();
            let staged = self.x.stage(lanes, patches, (first, images), own);
            let mut cursor = Cursor::new(pixels.len());
            for row in (0..rows).step_by(ROWS) {
                let count = ROWS.min(rows - row);
                let mut windows = [0; ROWS];
                for (r, window) in windows.iter_mut().enumerate() {
                    // an incomplete block ends with copies of its last row
                    *window = cursor.at(pixels, patches.staged());
                    if r + 1 < count {
                        cursor.advance();
                    }
                }
                cursor.advance();
                for c in 0..patches.blocks() {
                    // what one orbit reads of a block of channels the next reads from the first-level cache
                    for orbit in 0..patches.orbits() {
                        let first = patches.folded_of(orbit).start + c;
                        let panel = &mut panel[first * ROWS..];
                        let step = patches.blocks() * ROWS;
                        patches.gather(lanes, (orbit, c), staged, &windows, panel, step);
                    }
                }
                forward::<T, L, G>(lanes, panel.as_chunks().0, w, sums, count);
                finish.run(sums, first * pixels.len() + row, count);
            }
        }
    }
}

/// What happens to the sums of an output pixel.
pub(crate) struct Finish<'a, T, L, const G: usize> {
    lanes: L,
    width: usize,
    join: Join,
    channels: usize,
    regular: bool,
    bias: &'a [Block<T>],
    /// Room for ROWS pixels.
    own: &'a mut [Block<T>],
    to: Output<'a, T>,
    /// The pixel of the output that it begins with.
    start: usize,
    /// Blocks of a staged image before that pixel.
    skipped: usize,
}

impl<'a, T: Scalar, L: Lanes<T>, const G: usize> Finish<'a, T, L, G> {
    #[inline(always)]
    pub fn new(
        lanes: L,
        conv: &R2Conv,
        params: &[T],
        scratch: &mut Scratch<'a, T>,
        to: Output<'a, T>,
    ) -> Self {
        let shape = conv.shape_out();
        let width = conv.weights().width();
        let start = to.lines.start * shape.width;
        let skipped = match &to.y {
            MapsMut::Channels(_) => 0,
            MapsMut::Staged(patches, _) => patches.before(start),
        };
        let biases = &params[conv.blocks().bias()];
        let bias = scratch.zeros(width);
        for (group, &b) in bias.as_flattened_mut().chunks_exact_mut(G).zip(biases) {
            group[0] = b;
        }
        Finish {
            lanes,
            width,
            join: Join::new(shape.fields),
            channels: shape.fields.dim(),
            regular: shape.fields.regular_fields().is_some(),
            bias,
            own: scratch.take(ROWS * width),
            to,
            start,
            skipped,
        }
    }

    /// Adds the bias, rectifies if there are masks, and writes `count` output pixels, at most ROWS, from pixel `first` of those it has.
    #[inline(always)]
    pub fn run(&mut self, sums: &[Block<T>], first: usize, count: usize) {
        let width = self.width;
        let mut places = [0; ROWS];
        let (to, scale) = match &mut self.to.y {
            MapsMut::Channels(_) => {
                for (r, place) in places.iter_mut().enumerate() {
                    *place = r * width;
                }
                (&mut *self.own, 1.0)
            }
            MapsMut::Staged(patches, y) => {
                let places = &mut places[..count];
                patches.places(self.start + first, places);
                for place in places {
                    *place -= self.skipped;
                }
                (y.as_chunks_mut().0, patches.scale())
            }
        };
        let rows = Rows {
            lanes: self.lanes,
            sums: &sums[..count * width],
            bias: self.bias,
            places: &places[..count],
        };
        let masks = self.to.masks.as_deref_mut();
        let masks = masks.map(|masks| &mut masks[first * width..][..count * width]);
        match masks {
            Some(masks) if self.regular => rows.rectify::<G>(masks, scale, to),
            Some(masks) => rows.rectify::<1>(masks, scale, to),
            None => rows.add_bias(scale, to),
        }
        if let MapsMut::Channels(y) = &mut self.to.y {
            let pixels = y[first * self.channels..].chunks_exact_mut(self.channels.max(1));
            let own = self.own.chunks_exact(width.max(1));
            for (own, y) in own.take(count).zip(pixels) {
                self.join
                    .undo::<T, G>(T::from_f64(1.0), own.as_flattened(), y);
            }
        }
    }
}

/// The sums `[row][block]` of some output pixels.
struct Rows<'a, T, L> {
    lanes: L,
    sums: &'a [Block<T>],
    bias: &'a [Block<T>],
    /// Where the first block of every row goes.
    places: &'a [usize],
}

impl<T: Scalar, L: Lanes<T>> Rows<'_, T, L> {
    #[inline(always)]
    fn add_bias(&self, scale: f64, to: &mut [Block<T>]) {
        let (lanes, width) = (self.lanes, self.bias.len());
        let scale = lanes.splat(T::from_f64(scale));
        for (c, bias) in self.bias.iter().enumerate() {
            let bias = lanes.load(bias);
            for (r, place) in self.places.iter().enumerate() {
                let v = lanes.add(lanes.load(&self.sums[r * width + c]), bias);
                lanes.store(&mut to[place + c], lanes.mul(v, scale));
            }
        }
    }

    /// Adds the bias and rectifies in the basis that the group permutes.
    #[inline(always)]
    fn rectify<const G: usize>(&self, masks: &mut [T], scale: f64, to: &mut [Block<T>]) {
        let (lanes, width) = (self.lanes, self.bias.len());
        let masks = &mut masks[..self.sums.len()];
        let scale = lanes.splat(T::from_f64(scale / G as f64));
        for (c, bias) in self.bias.iter().enumerate() {
            let bias = lanes.load(bias);
            for (r, place) in self.places.iter().enumerate() {
                let v = lanes.add(lanes.load(&self.sums[r * width + c]), bias);
                let (v, bits) = lanes.rectify(transform::<T, L, G>(lanes, v));
                masks[r * width + c] = T::from_mask(bits);
                let v = lanes.mul(transform::<T, L, G>(lanes, v), scale);
                lanes.store(&mut to[place + c], v);
            }
        }
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
