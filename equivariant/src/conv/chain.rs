//! Convolutions and ReLUs, fused.
//!
//! Between the convolutions of a chain the feature maps stay as the kernels want them: a
//! convolution writes its rectified output straight into the staged image of the next, which is
//! also what the backward pass reads. Of the values before a ReLU only their signs are kept.

use std::ops::Range;

use crate::backward_pass::BackwardPass;
use crate::conv::geometry::Conv;
use crate::conv::maps::{Maps, MapsMut};
use crate::conv::pass::{Backward, Forward, Output};
use crate::conv::passes::{self, Passes};
use crate::conv::pieces::Pieces;
use crate::shape::Shape;
use crate::simd::lanes::LANES;

/// A layer that a chain can take.
#[derive(Clone, Copy, Debug)]
pub enum Fusible<'a> {
    /// A convolution.
    Conv(&'a Conv),
    /// A ReLU.
    Relu,
}

/// Convolutions, each perhaps with a ReLU.
#[derive(Clone, Debug)]
pub(crate) struct Chain {
    links: Vec<Link>,
}

#[derive(Clone, Debug)]
struct Link {
    conv: Conv,
    rectified: bool,
    params: Range<usize>,
}

impl Chain {
    /// The longest chain at the front of some layers, with their number, if it fuses anything.
    pub fn take<'a>(layers: impl Iterator<Item = Option<Fusible<'a>>>) -> Option<(Chain, usize)> {
        let mut chain = Chain { links: Vec::new() };
        let taken = layers.take_while(|layer| chain.accept(*layer)).count();
        (taken > 1).then_some((chain, taken))
    }

    /// Takes a layer that fits behind the last; says whether it does.
    fn accept(&mut self, layer: Option<Fusible>) -> bool {
        match (layer, self.links.last_mut()) {
            // trivial channels are staged in another way than they are written
            (Some(Fusible::Conv(conv)), Some(_)) if conv.patches.replicated() => false,
            (Some(Fusible::Conv(conv)), last) => {
                let start = last.map_or(0, |link| link.params.end);
                self.links.push(Link {
                    conv: conv.clone(),
                    rectified: false,
                    params: start..start + conv.num_params(),
                });
                true
            }
            (Some(Fusible::Relu), Some(last)) => !std::mem::replace(&mut last.rectified, true),
            _ => false,
        }
    }

    pub fn in_shape(&self) -> Shape {
        self.links[0].conv.image()
    }

    pub fn out_shape(&self) -> Shape {
        self.last().conv.out
    }

    pub fn num_params(&self) -> usize {
        self.last().params.end
    }

    /// The convolutions, in order.
    pub fn convs(&self) -> impl Iterator<Item = &Conv> {
        self.links.iter().map(|link| &link.conv)
    }

    pub fn scratch_len(&self, samples: usize) -> usize {
        let links = self.convs().enumerate();
        let passes = links.map(|(i, conv)| passes::scratch_len(conv, samples, i > 0));
        let own = self.kept(samples) + 2 * self.largest(samples);
        own + passes.max().unwrap_or(0)
    }

    fn last(&self) -> &Link {
        &self.links[self.links.len() - 1]
    }

    /// Values that the forward pass leaves to the backward pass.
    fn kept(&self, samples: usize) -> usize {
        let links = self.links.iter().enumerate();
        links
            .map(|(i, link)| link.masks(samples) + self.staged(i, samples))
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

    /// The length of the largest staged images.
    fn largest(&self, samples: usize) -> usize {
        let links = 0..self.links.len();
        links.map(|i| self.staged(i, samples)).max().unwrap_or(0)
    }

    pub fn forward<T: Passes>(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]) {
        let samples = x.len() / self.in_shape().len();
        let mut pieces = Pieces::new(scratch);
        let mut kept = Pieces::new(pieces.take_flat(self.kept(samples)));
        let scratch = pieces.rest();
        let mut x = Maps::Channels(x);
        for (i, pair) in self.links.windows(2).enumerate() {
            let masks = kept.take_flat(pair[0].masks(samples));
            let staged = kept.take_flat(self.staged(i + 1, samples));
            let patches = &pair[1].conv.patches;
            let images = staged.chunks_exact_mut(patches.staged());
            images.for_each(|image| patches.clear_border(image));
            let y = MapsMut::Staged(patches, staged);
            pair[0].forward(params, (samples, x), (y, masks), scratch);
            x = Maps::Staged(patches, staged);
        }
        let masks = kept.take_flat(self.last().masks(samples));
        let y = MapsMut::Channels(y);
        self.last()
            .forward(params, (samples, x), (y, masks), scratch);
    }

    pub fn backward<T: Passes>(&self, pass: BackwardPass<T>) {
        let samples = pass.x.len() / self.in_shape().len();
        let mut pieces = Pieces::new(pass.scratch);
        let mut kept = &*pieces.take_flat(self.kept(samples));
        let mut output_gradient = pieces.take_flat(self.largest(samples));
        let mut input_gradient = pieces.take_flat(self.largest(samples));
        let scratch = pieces.rest();
        let mut dx = pass.dx;
        for (i, link) in self.links.iter().enumerate().rev() {
            let patches = &link.conv.patches;
            let masks = take_back(&mut kept, link.masks(samples));
            let staged = take_back(&mut kept, self.staged(i, samples));
            let (x, dx) = match i {
                0 => (Maps::Channels(pass.x), dx.take().map(MapsMut::Channels)),
                _ => {
                    let dx = &mut input_gradient[..staged.len()];
                    (
                        Maps::Staged(patches, staged),
                        Some(MapsMut::Staged(patches, dx)),
                    )
                }
            };
            T::backward(Backward {
                conv: &link.conv,
                samples,
                params: &pass.params[link.params.clone()],
                x,
                dy: match self.links.get(i + 1) {
                    None => Maps::Channels(pass.dy),
                    Some(next) => Maps::Staged(&next.conv.patches, output_gradient),
                },
                masks: link.rectified.then_some(masks),
                dx,
                dparams: &mut pass.dparams[link.params.clone()],
                scratch,
            });
            std::mem::swap(&mut output_gradient, &mut input_gradient);
        }
    }
}

impl Link {
    fn forward<T: Passes>(
        &self,
        params: &[T],
        (samples, x): (usize, Maps<T>),
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

    /// The length of the masks of the ReLU, in whole blocks.
    fn masks(&self, samples: usize) -> usize {
        let rows = samples * self.conv.out.pixels();
        let masks = rows * self.conv.weights.width();
        if self.rectified {
            masks.next_multiple_of(LANES)
        } else {
            0
        }
    }
}

fn take_back<'a, T>(rest: &mut &'a [T], len: usize) -> &'a [T] {
    let (front, back) = rest.split_at(rest.len() - len);
    *rest = front;
    back
}
