//! The feature maps that passes read and write, and their scratch.

use crate::Scalar;
use crate::lanes::{Block, LANES, Lanes};
use crate::patches::Patches;

/// Feature maps of some samples.
#[derive(Clone, Copy)]
pub(crate) enum Maps<'a, T> {
    /// `[N, H, W, C]`, irrep-major channels.
    Channels(&'a [T]),
    /// Staged for the convolution with these patches.
    Staged(&'a Patches, &'a [T]),
}

/// The same, to be written.
pub(crate) enum MapsMut<'a, T> {
    Channels(&'a mut [T]),
    Staged(&'a Patches, &'a mut [T]),
}

impl<T: Scalar> Maps<'_, T> {
    /// Some of the images, staged; `own` has room for them in case they are not.
    #[inline(always)]
    pub fn stage<'b, L: Lanes<T>>(
        &'b self,
        lanes: L,
        patches: &Patches,
        (first, images): (usize, usize),
        own: &'b mut [T],
    ) -> &'b [T] {
        let staged = patches.staged();
        match self {
            Maps::Channels(x) => {
                let len = patches.image().len();
                for i in 0..images {
                    let x = &x[(first + i) * len..][..len];
                    patches.stage(lanes, x, &mut own[i * staged..][..staged]);
                }
                own
            }
            Maps::Staged(_, x) => &x[first * staged..][..images * staged],
        }
    }
}

impl<'a, T: Scalar> MapsMut<'a, T> {
    /// The maps of a single image before this pixel, and from it on; it must be the first of a line. `channels` of a pixel.
    pub fn split(self, pixel: usize, channels: usize) -> (MapsMut<'a, T>, MapsMut<'a, T>) {
        match self {
            MapsMut::Channels(y) => {
                let (above, below) = y.split_at_mut(pixel * channels);
                (MapsMut::Channels(above), MapsMut::Channels(below))
            }
            MapsMut::Staged(patches, y) => {
                let (above, below) = y.split_at_mut(patches.before(pixel) * LANES);
                (
                    MapsMut::Staged(patches, above),
                    MapsMut::Staged(patches, below),
                )
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
        Cursor {
            image: 0,
            pixel: 0,
            pixels,
        }
    }

    #[inline(always)]
    pub fn advance(&mut self) {
        self.pixel += 1;
        if self.pixel == self.pixels {
            self.pixel = 0;
            self.image += 1;
        }
    }

    /// Where the pixel lies in staged images.
    #[inline(always)]
    pub fn at(&self, offsets: &[usize], staged: usize) -> usize {
        self.image * staged + offsets[self.pixel]
    }
}

/// Splits blocks off the front of a scratch.
pub(crate) struct Scratch<'a, T> {
    rest: &'a mut [Block<T>],
}

impl<'a, T: Scalar> Scratch<'a, T> {
    /// Blocks start on cache lines: a load that straddles two of them takes twice the time.
    pub fn new(scratch: &'a mut [T]) -> Scratch<'a, T> {
        let skipped = scratch.as_ptr().align_offset(64).min(LANES);
        Scratch {
            rest: scratch[skipped..].as_chunks_mut().0,
        }
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

    /// The same, filled with zeros.
    pub fn zeros(&mut self, blocks: usize) -> &'a mut [Block<T>] {
        let front = self.take(blocks);
        front.as_flattened_mut().fill(T::ZERO);
        front
    }

    /// The length of a scratch with this many blocks.
    pub fn len(blocks: usize) -> usize {
        (blocks + 1) * LANES
    }

    /// What is left, for another scratch.
    pub fn rest(self) -> &'a mut [T] {
        self.rest.as_flattened_mut()
    }
}

/// Fills a slice with zeros.
pub(crate) fn zeros<T: Scalar>(values: &mut [T]) -> &mut [T] {
    values.fill(T::ZERO);
    values
}
