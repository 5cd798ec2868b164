//! Images in the blocked layout, and the geometry of folded patches.
//!
//! Read this before editing. An image in the *blocked layout* is padded with zeros and holds the
//! channels of a pixel in blocks of sixteen values, similar to the blocked layouts of oneDNN, but
//! field by field: G lanes per field, one for each irrep. The fold of an orbit of taps is then a
//! butterfly over a few blocks. Its result of parity p leads from input irrep a = b p to output
//! irrep b, by a swap of lanes within the groups. A *panel* holds the folded patches of some rows
//! (output pixels), `[block][row]`, like im2col does for ordinary convolutions.
//!
//! Trivial channels would leave most lanes empty. They are stored as G copies, and the lanes of a
//! folded group are the parities of one orbit, since parity b leads from the trivial irrep to irrep
//! b. For D2 the copies are folded along y already (see [`FoldedLines`]), since the windows of a
//! line share that fold.

use std::ops::Range;

use symmetry::{Group, Irrep};

use crate::real::Real;
use crate::shape::Shape;
use crate::simd::interleave::Interleaver;
use crate::simd::lanes::{Block, LANES, Lanes};
use crate::simd::lines::{FoldedLines, Pixel};
use crate::steerable::hadamard::with_const_order;
use crate::steerable::taps::TapBasis;
use crate::window::SlidingWindow;

/// Geometry of images in the blocked layout and of their folded patches: im2col patches in which
/// the signed sums (folds) of each orbit of taps replace the taps.
#[derive(Clone, Debug)]
pub(crate) struct PatchGeometry {
    pub image_shape: Shape,
    pub window: SlidingWindow,
    /// Start of the window of every output pixel in a blocked image.
    pub window_starts: Vec<usize>,
    /// Index of every pixel of the image in a blocked image.
    pub pixel_starts: Vec<usize>,
    /// Length of a blocked pixel, in values.
    pixel_len: usize,
    /// Number of blocks of a blocked pixel, the last of which may be partly filled.
    pub blocks_per_pixel: usize,
    /// `true` if the channels are trivial and stored as G copies, one for each group element.
    pub is_replicated: bool,
    /// Folded lines of trivial channels of D2; `None` for other types.
    pub folded_lines: Option<FoldedLines>,
    pub orbits: Vec<TapOrbit>,
    pub blocks_per_folded_patch: usize,
}

/// Orbit {g t} of a tap t over the group elements g, whose taps are folded into signed sums.
#[derive(Clone, Debug)]
pub(crate) struct TapOrbit {
    /// First tap `[row, column]` of the orbit.
    pub first_tap: [usize; 2],
    /// Offsets of the orbit's taps from the start of a window in a blocked image, in values.
    pub tap_offsets: Vec<usize>,
    /// Irreps (parities) by whose signs the orbit's taps are summed, as positions in the group's
    /// list of irreps.
    pub parities: Vec<usize>,
    /// Index of the first block of a folded patch that holds signed sums (folds) of this orbit.
    pub first_block: usize,
    /// Factor that makes the orbit's fold orthonormal, if blocked values are divided by sqrt(G).
    pub scale: f64,
    /// Coefficient of each tap of the orbit in each lane, for trivial channels that are stored as G
    /// copies.
    pub coefficients: Vec<Block<f64>>,
}

impl PatchGeometry {
    pub fn new(
        taps: &TapBasis,
        image: Shape,
        kernel: SlidingWindow,
        out_size: [usize; 2],
    ) -> PatchGeometry {
        let group = image.fields.group();
        // a field has a lane for each irrep, so every irrep gets as many lanes as the most frequent
        // one
        let irreps = group.irreps().iter();
        let fields = irreps.map(|&a| image.fields.multiplicity(a)).max();
        let lanes = fields.unwrap_or(0) * group.order();
        let blocks = lanes.div_ceil(LANES);
        let mut patches = PatchGeometry {
            image_shape: image,
            window: kernel,
            window_starts: Vec::new(),
            pixel_starts: Vec::new(),
            pixel_len: blocks * LANES,
            blocks_per_pixel: blocks,
            is_replicated: image.fields.is_trivial() && group.order() > 1,
            folded_lines: None,
            orbits: Vec::new(),
            blocks_per_folded_patch: 0,
        };
        if patches.is_replicated {
            // Pixels are packed: a load also reads the next ones, and their lanes meet weights of
            // zero.
            patches.pixel_len = lanes;
        }
        patches.window_starts = patches.offsets(out_size, kernel.stride, 0);
        if patches.is_replicated && group == Group::D2 {
            let line = patches.padded_width() * patches.pixel_len;
            let lines = FoldedLines::new(image, kernel, out_size[0], line);
            for (i, window) in patches.window_starts.iter_mut().enumerate() {
                let (oy, ox) = (i / out_size[1].max(1), i % out_size[1].max(1));
                *window = lines.alignment_shift()
                    + lines.first_line_start(oy)
                    + ox * kernel.stride * patches.pixel_len;
            }
            patches.folded_lines = Some(lines);
        }
        patches.pixel_starts = patches.offsets([image.height, image.width], 1, kernel.padding);
        for function in &taps.basis_functions {
            patches.add(taps, function.tap_coefficients[0].0);
        }
        patches
    }

    /// Returns the offsets of a grid of pixels in a blocked image, in values.
    fn offsets(&self, [height, width]: [usize; 2], step: usize, first: usize) -> Vec<usize> {
        let at = |y, x| (first + y * step) * self.padded_width() + first + x * step;
        let lines = (0..height).flat_map(|y| (0..width).map(move |x| (y, x)));
        lines.map(|(y, x)| at(y, x) * self.pixel_len).collect()
    }

    /// Adds the orbit of taps that starts with tap `start`, unless it exists.
    fn add(&mut self, taps: &TapBasis, start: [usize; 2]) {
        if self.orbits.iter().any(|o| o.first_tap == start) {
            return;
        }
        let offset = |[y, x]: [usize; 2]| (y * self.padded_width() + x) * self.pixel_len;
        let group = self.image_shape.fields.group();
        let functions = taps.basis_functions.iter().filter(|f| f.tap_coefficients[0].0 == start);
        let functions: Vec<_> = functions.collect();
        let position = |p: Irrep| group.irreps().iter().position(|&a| a == p).unwrap_or(0);
        let parities: Vec<usize> = functions.iter().map(|f| position(f.parity)).collect();
        let mut parts = functions[0].tap_coefficients.clone();
        // the rows of taps below the first are folded into the lines already
        parts.retain(|(tap, _)| self.folded_lines.is_none() || tap[0] == start[0]);
        let orbit_len = functions[0].tap_coefficients.len();
        let coefficients = (0..parts.len()).map(|tap| {
            std::array::from_fn(|lane| {
                let of_lane = parities.iter().position(|&p| p == lane % group.order());
                of_lane.map_or(0.0, |i| functions[i].tap_coefficients[tap].1)
            })
        });
        let orbit = TapOrbit {
            first_tap: start,
            tap_offsets: parts.iter().map(|part| offset(part.0)).collect(),
            first_block: self.blocks_per_folded_patch,
            scale: (group.order() as f64 / orbit_len as f64).sqrt(),
            coefficients: coefficients.collect(),
            parities,
        };
        self.blocks_per_folded_patch +=
            self.blocks_per_pixel * if self.is_replicated { 1 } else { parts.len() };
        self.orbits.push(orbit);
    }

    /// Returns the range of blocks of a folded patch that come from one orbit of taps.
    pub fn orbit_blocks(&self, orbit: usize) -> Range<usize> {
        let next =
            self.orbits.get(orbit + 1).map_or(self.blocks_per_folded_patch, |o| o.first_block);
        self.orbits[orbit].first_block..next
    }

    /// Returns the first lane group of a folded patch that holds the channels of the basis function
    /// of parity `parity` on the orbit of tap `start`.
    pub fn first_lane_group(&self, parity: Irrep, start: [usize; 2]) -> usize {
        let group = self.image_shape.fields.group();
        let per_block = LANES / group.order();
        let Some(orbit) = self.orbits.iter().find(|o| o.first_tap == start) else {
            unreachable!("every function starts with the first tap of an orbit")
        };
        let fold = orbit.parities.iter().position(|&p| group.irreps()[p] == parity);
        let skipped = if self.is_replicated { 0 } else { fold.unwrap_or(0) };
        (orbit.first_block + skipped * self.blocks_per_pixel) * per_block
    }

    /// Returns the width of a blocked image in pixels, with padding.
    fn padded_width(&self) -> usize {
        self.image_shape.width + 2 * self.window.padding
    }

    /// Returns the length of a blocked image in values, including space to load a block at the last
    /// pixel.
    pub fn blocked_len(&self) -> usize {
        let line = self.padded_width() * self.pixel_len;
        let lines = match &self.folded_lines {
            Some(lines) => lines.num_lines(),
            None => self.image_shape.height + 2 * self.window.padding,
        };
        let beyond = (self.blocks_per_pixel + 1) * LANES - self.pixel_len;
        (lines * line + beyond).next_multiple_of(LANES)
    }

    /// Writes the positions of consecutive pixels, from pixel `first` on, in blocked images, in
    /// blocks.
    #[inline(always)]
    pub fn write_pixel_block_offsets(&self, first: usize, places: &mut [usize]) {
        let pixels = self.pixel_starts.len();
        let (mut start, mut pixel) = (first / pixels * self.blocked_len(), first % pixels);
        for place in places {
            *place = (start + self.pixel_starts[pixel]) / LANES;
            pixel += 1;
            if pixel == pixels {
                (start, pixel) = (start + self.blocked_len(), 0);
            }
        }
    }

    /// Returns the number of blocks of a blocked image before a pixel; the padding above the first
    /// pixel belongs to it.
    pub fn blocks_before_pixel(&self, pixel: usize) -> usize {
        match pixel {
            0 => 0,
            _ => self.pixel_starts[pixel] / LANES,
        }
    }

    /// Returns the factor 1/sqrt(G) of blocked values, for G group elements, with which folds over
    /// orbits of G taps are orthonormal.
    pub fn blocked_value_scale(&self) -> f64 {
        (self.image_shape.fields.group().order() as f64).sqrt().recip()
    }

    /// Writes zeros into the padding around the pixels of a blocked image.
    pub fn clear_border<T: Real>(&self, blocked: &mut [T]) {
        let line = self.image_shape.width * self.pixel_len;
        let mut end = 0;
        for &start in self.pixel_starts.iter().step_by(self.image_shape.width.max(1)) {
            blocked[end..start].fill(T::ZERO);
            end = start + line;
        }
        blocked[end..].fill(T::ZERO);
    }

    /// Writes one image into `blocked` in the blocked layout. Padding and lanes without a
    /// channel must be zero and stay so.
    #[inline(always)]
    pub fn write_blocked_image<T: Real, L: Lanes<T>>(
        &self,
        lanes: L,
        image: &[T],
        blocked: &mut [T],
    ) {
        if let Some(lines) = &self.folded_lines {
            return lines.fold_image(lanes, image, 0..lines.out_height, blocked);
        }
        let order = self.image_shape.fields.group().order();
        with_const_order!(G = order, self.write_blocked_groups::<T, G>(image, blocked));
    }

    #[inline(always)]
    fn write_blocked_groups<T: Real, const G: usize>(&self, image: &[T], blocked: &mut [T]) {
        if self.is_replicated {
            return self.write_copies::<T, _, G>(image, blocked);
        }
        let channels = self.image_shape.fields.dim();
        let scale = T::from_f64(self.blocked_value_scale());
        let interleaver = Interleaver::new(self.image_shape.fields);
        for (i, &to) in self.pixel_starts.iter().enumerate() {
            let from = &image[i * channels..][..channels];
            interleaver.interleave::<T, G>(scale, from, &mut blocked[to..][..self.pixel_len]);
        }
    }

    /// Writes an image of bytes, which stand for trivial channels, into `blocked` in the
    /// blocked layout, for groups other than D2.
    #[inline(always)]
    pub fn write_blocked_bytes<T: Real>(&self, image: &[u8], blocked: &mut [T]) {
        let order = self.image_shape.fields.group().order();
        with_const_order!(G = order, self.write_copies::<T, _, G>(image, blocked));
    }

    /// Writes G copies of every channel of an image to the blocked image.
    #[inline(always)]
    fn write_copies<T: Real, P: Pixel<T>, const G: usize>(&self, image: &[P], blocked: &mut [T]) {
        let channels = self.image_shape.fields.dim();
        for (pixel, &to) in image.chunks_exact(channels).zip(&self.pixel_starts) {
            let groups = blocked[to..][..channels * G].as_chunks_mut().0;
            for (group, x) in groups.iter_mut().zip(pixel) {
                *group = [x.to_number(); G];
            }
        }
    }

    /// Applies the transpose of [`write_blocked_image`](PatchGeometry::write_blocked_image), which
    /// takes the gradient of a blocked image to that of the image, and overwrites `image` with it.
    #[inline(always)]
    pub fn read_blocked_gradient<T: Real>(&self, blocked: &[T], image: &mut [T]) {
        if let Some(lines) = &self.folded_lines {
            return lines.fold_image_backward(blocked, image);
        }
        let order = self.image_shape.fields.group().order();
        with_const_order!(G = order, self.read_blocked_groups::<T, G>(blocked, image));
    }

    #[inline(always)]
    fn read_blocked_groups<T: Real, const G: usize>(&self, blocked: &[T], image: &mut [T]) {
        let channels = self.image_shape.fields.dim();
        let scale = T::from_f64(self.blocked_value_scale());
        let interleaver = Interleaver::new(self.image_shape.fields);
        for (i, &from) in self.pixel_starts.iter().enumerate() {
            let to = &mut image[i * channels..][..channels];
            let from = &blocked[from..][..self.pixel_len];
            if self.is_replicated {
                sum_copies::<T, G>(from, to);
            } else {
                interleaver.deinterleave_channels::<T, G>(scale, from, to);
            }
        }
    }
}

/// Writes the sum of the G copies of every channel of a pixel.
#[inline(always)]
fn sum_copies<T: Real, const G: usize>(groups: &[T], channels: &mut [T]) {
    for (group, x) in groups.as_chunks::<G>().0.iter().zip(channels) {
        let mut sum = group[0];
        for &copy in &group[1..] {
            sum += copy;
        }
        *x = sum;
    }
}
