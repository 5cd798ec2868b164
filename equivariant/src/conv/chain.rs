//! Convolutions, ReLUs and max-poolings, fused.
//!
//! Between the convolutions of a chain the feature maps stay as the kernels want them: a
//! convolution, or the pooling behind it, writes its output straight into the staged image of the
//! next, which is also what the backward pass reads. Of the values before a ReLU only their signs
//! are kept.

use std::ops::Range;

use crate::conv::dispatch::{self, Passes};
use crate::conv::maps::{Input, Maps, MapsMut, Pieces};
use crate::conv::operands::{Backward, Forward, Output};
use crate::conv::pool::{Pool, Pooling, Unpooling};
use crate::conv::r2_conv::R2Conv;
use crate::scratch::BackwardPass;
use crate::shape::Shape;
use crate::simd::lanes::LANES;
use crate::window::Kernel;

/// Convolutions, each perhaps with a ReLU, and then perhaps with a pooling.
#[derive(Clone, Debug)]
pub(crate) struct Chain {
    links: Vec<Link>,
}

#[derive(Clone, Debug)]
struct Link {
    conv: R2Conv,
    rectified: bool,
    pool: Option<Pool>,
    params: Range<usize>,
}

impl Chain {
    /// A chain of one convolution.
    pub fn new(conv: &R2Conv) -> Chain {
        let mut chain = Chain { links: Vec::new() };
        chain.push(conv);
        chain
    }

    fn push(&mut self, conv: &R2Conv) {
        let start = self.links.last().map_or(0, |link| link.params.end);
        self.links.push(Link {
            conv: conv.clone(),
            rectified: false,
            pool: None,
            params: start..start + conv.blocks.num_params(),
        });
    }

    /// Takes a convolution; returns `false` if it does not fit behind the last one. Trivial
    /// channels are staged in another way than they are written.
    pub fn convolve(&mut self, conv: &R2Conv) -> bool {
        let fits = !conv.patches.replicated();
        if fits {
            self.push(conv);
        }
        fits
    }

    /// Takes a ReLU; returns `false` if the last convolution has one or is pooled.
    pub fn rectify(&mut self) -> bool {
        let last = self.last_mut();
        last.pool.is_none() && !std::mem::replace(&mut last.rectified, true)
    }

    /// Takes a max-pooling; returns `false` if the last convolution is pooled or the windows do not
    /// fit (see [`Pool::behind`]).
    pub fn pool(&mut self, kernel: Kernel) -> bool {
        let last = self.last_mut();
        if last.pool.is_some() {
            return false;
        }
        last.pool = Pool::behind(&last.conv, kernel);
        last.pool.is_some()
    }

    pub fn in_shape(&self) -> Shape {
        self.links[0].conv.image()
    }

    pub fn out_shape(&self) -> Shape {
        self.last().out()
    }

    pub fn num_params(&self) -> usize {
        self.last().params.end
    }

    /// Output of each convolution, in order.
    pub fn outs(&self) -> impl Iterator<Item = Shape> {
        self.links.iter().map(Link::out)
    }

    pub fn scratch_len(&self, samples: usize) -> usize {
        let links = self.links.iter().enumerate();
        let passes = links.map(|(i, link)| {
            let pool = link.pool.as_ref().map_or(0, Pool::scratch_len);
            dispatch::scratch_len(&link.conv, samples, i > 0).max(pool)
        });
        let own = self.kept(samples) + 2 * self.largest(samples);
        own + passes.max().unwrap_or(0)
    }

    fn last(&self) -> &Link {
        &self.links[self.links.len() - 1]
    }

    fn last_mut(&mut self) -> &mut Link {
        let last = self.links.len() - 1;
        &mut self.links[last]
    }

    /// Values that the forward pass leaves to the backward pass.
    pub fn kept(&self, samples: usize) -> usize {
        let links = self.links.iter().enumerate();
        links
            .map(|(i, link)| self.staged(i, samples) + link.masks(samples) + link.pooled(samples))
            .sum()
    }

    /// The length of the staged images between link `i` and the one before; the first is given
    /// channels.
    fn staged(&self, i: usize, samples: usize) -> usize {
        match i {
            0 => 0,
            _ => samples * self.links[i].conv.patches.staged(),
        }
    }

    /// The length of the largest images between convolutions and poolings.
    fn largest(&self, samples: usize) -> usize {
        let links = self.links.iter().enumerate();
        let largest = links.map(|(i, link)| self.staged(i, samples).max(link.pooled(samples)));
        largest.max().unwrap_or(0)
    }

    /// Writes what the chain makes of so many samples, which are not staged.
    pub fn forward<T: Passes>(
        &self,
        params: &[T],
        (samples, mut x): (usize, Input<T>),
        y: &mut [T],
        scratch: &mut [T],
    ) {
        let mut pieces = Pieces::new(scratch);
        let mut kept = Pieces::new(pieces.take_flat(self.kept(samples)));
        let scratch = pieces.rest();
        for (i, pair) in self.links.windows(2).enumerate() {
            let own = pair[0].keep(samples, &mut kept);
            let staged = kept.take_flat(self.staged(i + 1, samples));
            let patches = &pair[1].conv.patches;
            let images = staged.chunks_exact_mut(patches.staged());
            images.for_each(|image| patches.clear_border(image));
            let y = MapsMut::Staged(patches, staged);
            pair[0].forward(params, (samples, x), (y, own), scratch);
            x = Input::Staged(staged);
        }
        let own = self.last().keep(samples, &mut kept);
        let y = MapsMut::Channels(y);
        self.last().forward(params, (samples, x), (y, own), scratch);
    }

    /// Adds and writes gradients for the same samples: `x` is what the pass would hold, or stands
    /// for it.
    pub fn backward<T: Passes>(&self, (samples, x): (usize, Input<T>), pass: BackwardPass<T>) {
        let mut pieces = Pieces::new(pass.scratch);
        let mut kept = &*pieces.take_flat(self.kept(samples));
        let mut output_gradient = pieces.take_flat(self.largest(samples));
        let mut input_gradient = pieces.take_flat(self.largest(samples));
        let scratch = pieces.rest();
        let mut dx = pass.dx;
        for (i, link) in self.links.iter().enumerate().rev() {
            let patches = &link.conv.patches;
            let pooled = take_back(&mut kept, link.pooled(samples));
            let masks = take_back(&mut kept, link.masks(samples));
            let staged = take_back(&mut kept, self.staged(i, samples));
            let mut dy = match self.links.get(i + 1) {
                None => Maps::Channels(pass.dy),
                Some(next) => Maps::Staged(&next.conv.patches, output_gradient),
            };
            if let Some(pool) = &link.pool {
                let dx = &mut input_gradient[..pooled.len()];
                T::unpool(Unpooling { pool, samples, x: pooled, dy, dx, scratch });
                std::mem::swap(&mut output_gradient, &mut input_gradient);
                dy = Maps::Staged(&pool.patches, output_gradient);
            }
            let (x, dx) = match i {
                0 => (x, dx.take().map(MapsMut::Channels)),
                _ => {
                    let dx = &mut input_gradient[..staged.len()];
                    (Input::Staged(staged), Some(MapsMut::Staged(patches, dx)))
                }
            };
            T::backward(Backward {
                conv: &link.conv,
                samples,
                params: &pass.params[link.params.clone()],
                x,
                dy,
                masks: link.rectified.then_some(masks),
                dx,
                dparams: &mut pass.dparams[link.params.clone()],
                scratch,
            });
            std::mem::swap(&mut output_gradient, &mut input_gradient);
        }
    }
}

/// Values that the forward pass of a link leaves to the backward pass.
struct Kept<'a, T> {
    masks: &'a mut [T],
    /// Input of a pooling.
    pooled: &'a mut [T],
}

impl Link {
    fn out(&self) -> Shape {
        self.pool.as_ref().map_or(self.conv.out, |pool| pool.out)
    }

    fn keep<'a, T: Passes>(&self, samples: usize, kept: &mut Pieces<'a, T>) -> Kept<'a, T> {
        Kept {
            masks: kept.take_flat(self.masks(samples)),
            pooled: kept.take_flat(self.pooled(samples)),
        }
    }

    fn forward<T: Passes>(
        &self,
        params: &[T],
        (samples, x): (usize, Input<T>),
        (y, kept): (MapsMut<T>, Kept<T>),
        scratch: &mut [T],
    ) {
        let Some(pool) = &self.pool else {
            return self.convolve(params, (samples, x), (y, kept.masks), scratch);
        };
        let before = MapsMut::Staged(&pool.patches, &mut *kept.pooled);
        self.convolve(params, (samples, x), (before, kept.masks), scratch);
        T::pool(Pooling { pool, samples, x: kept.pooled, y, scratch });
    }

    fn convolve<T: Passes>(
        &self,
        params: &[T],
        (samples, x): (usize, Input<T>),
        (y, masks): (MapsMut<T>, &mut [T]),
        scratch: &mut [T],
    ) {
        let pass = Forward {
            conv: &self.conv,
            samples,
            params: &params[self.params.clone()],
            x,
            to: Output {
                lines: 0..self.conv.out.height,
                y,
                masks: self.rectified.then_some(masks),
            },
            scratch,
        };
        pass.run_on_threads();
    }

    /// The length of the maps before a pooling.
    fn pooled(&self, samples: usize) -> usize {
        let pool = self.pool.as_ref();
        pool.map_or(0, |pool| samples * pool.patches.staged())
    }

    /// The length of the masks of the ReLU, in whole blocks.
    fn masks(&self, samples: usize) -> usize {
        let rows = samples * self.conv.out.pixels();
        let masks = rows * self.conv.weights.width();
        if self.rectified { masks.next_multiple_of(LANES) } else { 0 }
    }
}

fn take_back<'a, T>(rest: &mut &'a [T], len: usize) -> &'a [T] {
    let (front, back) = rest.split_at(rest.len() - len);
    *rest = front;
    back
}

#[cfg(test)]
mod tests {
    use super::*;
    use symmetry::{FieldType, Group};

    /// A convolution of a 6 x 8 map to this type.
    fn conv(to: FieldType) -> R2Conv {
        let from = to.group().trivial(3);
        R2Conv::new(from, to, Kernel::new(3, 1, 1), [6, 8]).unwrap()
    }

    /// `true` if a pooling of a rectified convolution to this type is fused.
    fn pools(to: FieldType, [size, stride, padding]: [usize; 3]) -> bool {
        let mut chain = Chain::new(&conv(to));
        assert!(chain.rectify() && !chain.rectify());
        let pooled = chain.pool(Kernel::new(size, stride, padding));
        assert!(!(pooled && chain.rectify()), "a ReLU behind a pooling");
        pooled
    }

    #[test]
    fn poolings_whose_windows_tile_the_map_are_fused() {
        for group in Group::ALL {
            assert!(pools(group.regular(3), [2, 2, 0]));
            assert!(pools(group.regular(3), [1, 1, 0]));
        }
        let overlapping = [3, 1, 1];
        let beyond_the_map = [4, 4, 0];
        for pool in [overlapping, beyond_the_map, [2, 1, 0], [5, 5, 0]] {
            assert!(!pools(Group::C1.regular(3), pool), "{pool:?}");
        }
        assert!(!pools(Group::D2.trivial(3), [2, 2, 0]));
    }
}
