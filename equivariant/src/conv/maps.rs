//! The feature maps that passes read and write, and how their scratch is cut up.

use crate::real::Real;
use crate::simd::lanes::{Block, LANES, Lanes};
use crate::simd::patches::Patches;

/// Input of a convolution for some samples.
#[derive(Clone, Copy)]
pub(crate) enum Input<'a, T> {
    /// `[N, H, W, C]`, irrep-major channels.
    Channels(&'a [T]),
    /// Pictures `[N, H, W, C]` of trivial channels, as bytes that stand for their
    /// [`level`](crate::level)s.
    Bytes(&'a [u8]),
    /// Staged for this convolution.
    Staged(&'a [T]),
}

/// Feature maps of some samples.
#[derive(Clone, Copy)]
pub(crate) enum Maps<'a, T> {
    /// `[N, H, W, C]`, irrep-major channels.
    Channels(&'a [T]),
    /// Staged for the convolution with these patches.
    Staged(&'a Patches, &'a [T]),
}

/// Feature maps of some samples, to be written.
pub(crate) enum MapsMut<'a, T> {
    Channels(&'a mut [T]),
    Staged(&'a Patches, &'a mut [T]),
}

impl<T: Real> Input<'_, T> {
    /// Some of the images, staged; `own` has room for them in case they are not.
    #[inline(always)]
    pub fn stage<'b, L: Lanes<T>>(
        &'b self,
        lanes: L,
        patches: &Patches,
        (first, images): (usize, usize),
        own: &'b mut [T],
    ) -> &'b [T] {
        let (staged, len) = (patches.staged(), patches.image().len());
        match self {
            Input::Channels(x) => {
                for i in 0..images {
                    let x = &x[(first + i) * len..][..len];
                    patches.stage(lanes, x, &mut own[i * staged..][..staged]);
                }
                own
            }
            Input::Bytes(x) => {
                for i in 0..images {
                    let x = &x[(first + i) * len..][..len];
                    patches.stage_bytes(x, &mut own[i * staged..][..staged]);
                }
                own
            }
            Input::Staged(x) => &x[first * staged..][..images * staged],
        }
    }
}

impl<'a, T: Real> MapsMut<'a, T> {
    /// The maps of a single image before this pixel, and from it on; it must be the first of a
    /// line. `channels` is their number at a pixel.
    pub fn split(self, pixel: usize, channels: usize) -> (MapsMut<'a, T>, MapsMut<'a, T>) {
        match self {
            MapsMut::Channels(y) => {
                let (above, below) = y.split_at_mut(pixel * channels);
                (MapsMut::Channels(above), MapsMut::Channels(below))
            }
            MapsMut::Staged(patches, y) => {
                let (above, below) = y.split_at_mut(patches.before(pixel) * LANES);
                (MapsMut::Staged(patches, above), MapsMut::Staged(patches, below))
            }
        }
    }
}

/// Counts the pixels of images.
pub(crate) struct Cursor {
    pub image: usize,
    pub pixel: usize,
    pixels: usize,
}

impl Cursor {
    pub fn new(pixels: usize) -> Cursor {
        Cursor { image: 0, pixel: 0, pixels }
    }

    #[inline(always)]
    pub fn advance(&mut self) {
        self.pixel += 1;
        if self.pixel == self.pixels {
            self.pixel = 0;
            self.image += 1;
        }
    }

    /// Index of the pixel in staged images.
    #[inline(always)]
    pub fn at(&self, offsets: &[usize], staged: usize) -> usize {
        self.image * staged + offsets[self.pixel]
    }
}

/// Splits whole blocks off the front of a scratch, so that each starts on a cache line if the
/// scratch does.
pub(crate) struct Pieces<'a, T> {
    rest: &'a mut [Block<T>],
}

impl<'a, T: Real> Pieces<'a, T> {
    pub fn new(scratch: &'a mut [T]) -> Pieces<'a, T> {
        Pieces { rest: scratch.as_chunks_mut().0 }
    }

    /// Splits off values; a multiple of a block.
    pub fn take_flat(&mut self, len: usize) -> &'a mut [T] {
        self.take(len / LANES).as_flattened_mut()
    }

    pub fn take(&mut self, blocks: usize) -> &'a mut [Block<T>] {
        let (front, rest) = std::mem::take(&mut self.rest).split_at_mut(blocks);
        self.rest = rest;
        front
    }

    /// Splits off blocks that are zero.
    pub fn zeros(&mut self, blocks: usize) -> &'a mut [Block<T>] {
        let front = self.take(blocks);
        front.as_flattened_mut().fill(T::ZERO);
        front
    }

    /// Values that are zero; a multiple of a block.
    pub fn flat_zeros(&mut self, len: usize) -> &'a mut [T] {
        self.zeros(len / LANES).as_flattened_mut()
    }

    /// The remaining values.
    pub fn rest(self) -> &'a mut [T] {
        self.rest.as_flattened_mut()
    }
}
