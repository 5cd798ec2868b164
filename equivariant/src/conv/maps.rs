//! Feature maps that passes read and write, and the arena that divides their scratch memory.

use std::ops::Range;

use crate::real::Real;
use crate::simd::lanes::{Block, LANES, Lanes};
use crate::simd::patches::PatchGeometry;

/// Input of a convolution, in one of three layouts.
#[derive(Clone, Copy)]
pub(crate) enum ConvInput<'a, T> {
    /// Numbers `[N, H, W, C]` (samples, height, width, channels), channels irrep-major.
    Channels(&'a [T]),
    /// Images `[N, H, W, C]` of trivial channels as bytes, which stand for their
    /// [`pixel_byte_to_float`](crate::pixel_byte_to_float)s.
    Bytes(&'a [u8]),
    /// Images in the blocked layout, for the convolution that reads them.
    Blocked(&'a [T]),
}

/// Feature maps that a pass reads, in one of two layouts.
#[derive(Clone, Copy)]
pub(crate) enum FeatureMaps<'a, T> {
    /// Numbers `[N, H, W, C]` (samples, height, width, channels), channels irrep-major.
    Channels(&'a [T]),
    /// Images in the blocked layout, for the convolution with these patches.
    Blocked(&'a PatchGeometry, &'a [T]),
}

/// Feature maps that a pass writes, in one of two layouts.
pub(crate) enum FeatureMapsMut<'a, T> {
    Channels(&'a mut [T]),
    Blocked(&'a PatchGeometry, &'a mut [T]),
}

impl<T: Real> ConvInput<'_, T> {
    /// Returns the images `images` in the blocked layout, converted into the buffer `own` if they
    /// have another layout.
    #[inline(always)]
    pub fn blocked_images<'b, L: Lanes<T>>(
        &'b self,
        lanes: L,
        patches: &PatchGeometry,
        images: Range<usize>,
        own: &'b mut [T],
    ) -> &'b [T] {
        let (blocked, len) = (patches.blocked_len(), patches.image_shape.len());
        match self {
            ConvInput::Channels(x) => {
                for (i, image) in images.enumerate() {
                    let x = &x[image * len..][..len];
                    patches.write_blocked_image(lanes, x, &mut own[i * blocked..][..blocked]);
                }
                own
            }
            ConvInput::Bytes(x) => {
                for (i, image) in images.enumerate() {
                    let x = &x[image * len..][..len];
                    patches.write_blocked_bytes(x, &mut own[i * blocked..][..blocked]);
                }
                own
            }
            ConvInput::Blocked(x) => &x[images.start * blocked..images.end * blocked],
        }
    }
}

impl<'a, T: Real> FeatureMapsMut<'a, T> {
    /// Splits the feature maps of a single image before `pixel`, which must be the first of a line;
    /// `channels` is the number of channels.
    pub fn split_at_pixel(
        self,
        pixel: usize,
        channels: usize,
    ) -> (FeatureMapsMut<'a, T>, FeatureMapsMut<'a, T>) {
        match self {
            FeatureMapsMut::Channels(y) => {
                let (above, below) = y.split_at_mut(pixel * channels);
                (FeatureMapsMut::Channels(above), FeatureMapsMut::Channels(below))
            }
            FeatureMapsMut::Blocked(patches, y) => {
                let (above, below) = y.split_at_mut(patches.blocks_before_pixel(pixel) * LANES);
                (FeatureMapsMut::Blocked(patches, above), FeatureMapsMut::Blocked(patches, below))
            }
        }
    }
}

/// Position of a pixel in a sequence of images, for loops over all of their pixels.
pub(crate) struct PixelCursor {
    pub image: usize,
    pub pixel: usize,
    pixels: usize,
}

impl PixelCursor {
    pub fn new(pixels: usize) -> PixelCursor {
        PixelCursor { image: 0, pixel: 0, pixels }
    }

    #[inline(always)]
    pub fn advance(&mut self) {
        self.pixel += 1;
        if self.pixel == self.pixels {
            self.pixel = 0;
            self.image += 1;
        }
    }

    /// Returns the position, in values, of the current pixel in blocked images of `blocked` values
    /// each; `offsets` holds the position of every pixel in one image.
    #[inline(always)]
    pub fn blocked_index(&self, offsets: &[usize], blocked: usize) -> usize {
        self.image * blocked + offsets[self.pixel]
    }
}

/// Arena that splits whole blocks off the front of a scratch memory. Each part starts on a cache
/// line if the scratch memory does.
pub(crate) struct Arena<'a, T> {
    rest: &'a mut [Block<T>],
}

impl<'a, T: Real> Arena<'a, T> {
    pub fn new(scratch: &'a mut [T]) -> Arena<'a, T> {
        Arena { rest: scratch.as_chunks_mut().0 }
    }

    /// Splits `len` values, a multiple of a block, off the arena; they may hold anything.
    pub fn take_values(&mut self, len: usize) -> &'a mut [T] {
        self.take_blocks(len / LANES).as_flattened_mut()
    }

    pub fn take_blocks(&mut self, blocks: usize) -> &'a mut [Block<T>] {
        let (taken, rest) = std::mem::take(&mut self.rest).split_at_mut(blocks);
        self.rest = rest;
        taken
    }

    /// Splits `blocks` blocks off the arena and fills them with zeros.
    pub fn take_zeroed_blocks(&mut self, blocks: usize) -> &'a mut [Block<T>] {
        let taken = self.take_blocks(blocks);
        taken.as_flattened_mut().fill(T::ZERO);
        taken
    }

    /// Splits `len` values, a multiple of a block, off the arena and fills them with zeros.
    pub fn take_zeroed_values(&mut self, len: usize) -> &'a mut [T] {
        self.take_zeroed_blocks(len / LANES).as_flattened_mut()
    }

    /// Returns the values of the arena that have not been taken.
    pub fn take_rest(self) -> &'a mut [T] {
        self.rest.as_flattened_mut()
    }
}
