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
    /// Images in the layout of the CPU kernels (staged), for the convolution that reads them.
    Staged(&'a [T]),
}

/// Feature maps that a pass reads, in one of two layouts.
#[derive(Clone, Copy)]
pub(crate) enum FeatureMaps<'a, T> {
    /// Numbers `[N, H, W, C]` (samples, height, width, channels), channels irrep-major.
    Channels(&'a [T]),
    /// Images in the layout of the CPU kernels (staged), for the convolution with these patches.
    Staged(&'a PatchGeometry, &'a [T]),
}

/// Feature maps that a pass writes, in one of two layouts.
pub(crate) enum FeatureMapsMut<'a, T> {
    Channels(&'a mut [T]),
    Staged(&'a PatchGeometry, &'a mut [T]),
}

impl<T: Real> ConvInput<'_, T> {
    /// Returns some of the images in the layout of the CPU kernels (staged); `own` is the buffer
    /// for images that are not staged yet.
    #[inline(always)]
    pub fn stage<'b, L: Lanes<T>>(
        &'b self,
        lanes: L,
        patches: &PatchGeometry,
        images: Range<usize>,
        own: &'b mut [T],
    ) -> &'b [T] {
        let (staged, len) = (patches.staged_len(), patches.image_shape.len());
        match self {
            ConvInput::Channels(x) => {
                for (i, image) in images.enumerate() {
                    let x = &x[image * len..][..len];
                    patches.stage(lanes, x, &mut own[i * staged..][..staged]);
                }
                own
            }
            ConvInput::Bytes(x) => {
                for (i, image) in images.enumerate() {
                    let x = &x[image * len..][..len];
                    patches.stage_bytes(x, &mut own[i * staged..][..staged]);
                }
                own
            }
            ConvInput::Staged(x) => &x[images.start * staged..images.end * staged],
        }
    }
}

impl<'a, T: Real> FeatureMapsMut<'a, T> {
    /// Splits the feature maps of a single image before `pixel`, which must be the first of a line;
    /// `channels` is the number of channels.
    pub fn split(
        self,
        pixel: usize,
        channels: usize,
    ) -> (FeatureMapsMut<'a, T>, FeatureMapsMut<'a, T>) {
        match self {
            FeatureMapsMut::Channels(y) => {
                let (above, below) = y.split_at_mut(pixel * channels);
                (FeatureMapsMut::Channels(above), FeatureMapsMut::Channels(below))
            }
            FeatureMapsMut::Staged(patches, y) => {
                let (above, below) = y.split_at_mut(patches.blocks_before_pixel(pixel) * LANES);
                (FeatureMapsMut::Staged(patches, above), FeatureMapsMut::Staged(patches, below))
            }
        }
    }
}

/// Counter of pixels over several images.
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

    /// Returns the index of the current pixel in staged images, in values.
    #[inline(always)]
    pub fn staged_index(&self, offsets: &[usize], staged: usize) -> usize {
        self.image * staged + offsets[self.pixel]
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

    /// Splits `len` values, a multiple of a block, off the arena.
    pub fn take_values(&mut self, len: usize) -> &'a mut [T] {
        self.take_blocks(len / LANES).as_flattened_mut()
    }

    pub fn take_blocks(&mut self, blocks: usize) -> &'a mut [Block<T>] {
        let (front, rest) = std::mem::take(&mut self.rest).split_at_mut(blocks);
        self.rest = rest;
        front
    }

    /// Splits `blocks` blocks off the arena and fills them with zeros.
    pub fn take_zeroed_blocks(&mut self, blocks: usize) -> &'a mut [Block<T>] {
        let front = self.take_blocks(blocks);
        front.as_flattened_mut().fill(T::ZERO);
        front
    }

    /// Splits `len` values, a multiple of a block, off the arena and fills them with zeros.
    pub fn take_zeroed_values(&mut self, len: usize) -> &'a mut [T] {
        self.take_zeroed_blocks(len / LANES).as_flattened_mut()
    }

    /// Returns the values of the arena that have not been taken.
    pub fn rest(self) -> &'a mut [T] {
        self.rest.as_flattened_mut()
    }
}
