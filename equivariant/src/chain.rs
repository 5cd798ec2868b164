//! Convolutions and ReLUs, fused.
//!
//! Between the convolutions of a chain the feature maps stay as the kernels want them: a convolution writes
//! its rectified output straight into the staged image of the next, which is also what the backward pass
//! reads. Of the values before a ReLU only their signs are kept.

use std::fmt;
use std::ops::Range;

use crate::conv_backward::Backward;
use crate::conv_forward::{Forward, Output};
use crate::lanes::LANES;
use crate::layer::Fusible;
use crate::maps::{Maps, MapsMut, Scratch};
use crate::{Layer, R2Conv, Scalar, Shape};

/// Convolutions, each perhaps with a ReLU.
#[derive(Clone, Debug)]
pub(crate) struct Chain {
    links: Vec<Link>,
}

#[derive(Clone, Debug)]
struct Link {
    conv: R2Conv,
    rectified: bool,
    params: Range<usize>,
}

impl Chain {
    /// The longest chain at the front of the layers, with their number, if it fuses anything.
    pub fn take<T: Scalar>(layers: &[Box<dyn Layer<T>>]) -> Option<(Chain, usize)> {
        let mut chain = Chain { links: Vec::new() };
        let mut taken = 0;
        for layer in layers {
            match layer.fusible() {
                Some(Fusible::Conv(conv)) if chain.accepts(conv) => chain.push(conv),
                Some(Fusible::Relu) if chain.links.last().is_some_and(|l| !l.rectified) => {
                    chain.links.last_mut()?.rectified = true;
                }
                _ => break,
            }
            taken += 1;
        }
        (taken > 1).then_some((chain, taken))
    }

    /// Trivial channels are staged in another way than they are written.
    fn accepts(&self, conv: &R2Conv) -> bool {
        self.links.is_empty() || !conv.patches().replicated()
    }

    fn push(&mut self, conv: &R2Conv) {
        let start = self.links.last().map_or(0, |link| link.params.end);
        self.links.push(Link {
            conv: conv.clone(),
            rectified: false,
            params: start..start + Layer::<f32>::num_params(conv),
        });
    }

    fn last(&self) -> usize {
        self.links.len() - 1
    }

    /// Values that the forward pass leaves to the backward pass.
    fn kept(&self, samples: usize) -> usize {
        let links = self.links.iter().enumerate();
        links
            .map(|(i, link)| link.masks(samples) + self.staged(i, samples))
            .sum()
    }

    /// The length of the staged images between link `i` and the one before; the first is given channels.
    fn staged(&self, i: usize, samples: usize) -> usize {
        match i {
            0 => 0,
            _ => samples * self.links[i].conv.patches().staged(),
        }
    }

    /// The length of the largest staged images.
    fn largest(&self, samples: usize) -> usize {
        let links = 0..self.links.len();
        links.map(|i| self.staged(i, samples)).max().unwrap_or(0)
    }
}

impl Link {
    /// The length of the masks of the ReLU, in whole blocks.
    fn masks(&self, samples: usize) -> usize {
        let rows = samples * self.conv.shape_out().pixels();
        let masks = rows * self.conv.weights().width();
        if self.rectified {
            masks.next_multiple_of(LANES)
        } else {
            0
        }
    }
}

impl<T: Scalar> Layer<T> for Chain {
    fn in_shape(&self) -> Shape {
        self.links[0].conv.shape_in()
    }

    fn out_shape(&self) -> Shape {
        self.links[self.last()].conv.shape_out()
    }

    fn num_params(&self) -> usize {
        self.links[self.last()].params.end
    }

    fn keeps_scratch(&self) -> bool {
        true
    }

    fn scratch_len(&self, samples: usize) -> usize {
        let links = self.links.iter().enumerate();
        let passes = links.map(|(i, link)| {
            let forward = Forward::<T>::scratch_len(&link.conv, samples, i > 0);
            let backward = Backward::<T>::scratch_len(&link.conv, samples, i > 0);
            forward.max(backward)
        });
        let own = self.kept(samples) + 2 * self.largest(samples);
        Scratch::<T>::len(0) + own + passes.max().unwrap_or(0)
    }

    fn forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]) {
        let samples = self.links[0].conv.shape_in().samples(x.len());
        let mut scratch = Scratch::new(scratch);
        let mut kept = Scratch::new(scratch.take_flat(self.kept(samples)));
        let scratch = scratch.rest();
        let mut y = Some(y);
        let mut x = Maps::Channels(x);
        for (i, link) in self.links.iter().enumerate() {
            let masks = kept.take_flat(link.masks(samples));
            let mut pass = Forward {
                conv: &link.conv,
                samples,
                params: &params[link.params.clone()],
                x,
                to: Output {
                    lines: 0..link.conv.shape_out().height,
                    y: MapsMut::Channels(&mut []),
                    masks: link.rectified.then_some(masks),
                },
                scratch,
            };
            let Some(next) = self.links.get(i + 1) else {
                pass.to.y = MapsMut::Channels(y.take().unwrap_or_default());
                return pass.run_on_threads();
            };
            let patches = next.conv.patches();
            let staged = kept.take_flat(self.staged(i + 1, samples));
            staged
                .chunks_exact_mut(patches.staged().max(1))
                .for_each(|image| patches.clear_border(image));
            pass.to.y = MapsMut::Staged(patches, staged);
            pass.run_on_threads();
            x = Maps::Staged(patches, staged);
        }
    }

    fn backward(
        &self,
        params: &[T],
        x: &[T],
        _y: &[T],
        dy: &[T],
        mut dx: Option<&mut [T]>,
        dparams: &mut [T],
        scratch: &mut [T],
    ) {
        let samples = self.links[0].conv.shape_in().samples(x.len());
        let mut scratch = Scratch::new(scratch);
        let mut kept = &*scratch.take_flat(self.kept(samples));
        let mut output_gradient = scratch.take_flat(self.largest(samples));
        let mut input_gradient = scratch.take_flat(self.largest(samples));
        let scratch = scratch.rest();
        for (i, link) in self.links.iter().enumerate().rev() {
            let patches = link.conv.patches();
            let masks = take_back(&mut kept, link.masks(samples));
            let staged = take_back(&mut kept, self.staged(i, samples));
            T::backward(Backward {
                conv: &link.conv,
                samples,
                params: &params[link.params.clone()],
                x: match i {
                    0 => Maps::Channels(x),
                    _ => Maps::Staged(patches, staged),
                },
                dy: match self.links.get(i + 1) {
                    None => Maps::Channels(dy),
                    Some(next) => Maps::Staged(next.conv.patches(), output_gradient),
                },
                masks: link.rectified.then_some(masks),
                dx: match i {
                    0 => dx.take().map(MapsMut::Channels),
                    _ => Some(MapsMut::Staged(
                        patches,
                        &mut input_gradient[..staged.len()],
                    )),
                },
                dparams: &mut dparams[link.params.clone()],
                scratch,
            });
            std::mem::swap(&mut output_gradient, &mut input_gradient);
        }
    }
}

fn take_back<'a, T>(rest: &mut &'a [T], len: usize) -> &'a [T] {
    let (front, back) = rest.split_at(rest.len() - len);
    *rest = front;
    back
}

impl fmt::Display for Chain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let links: Vec<String> = self.links.iter().map(|l| l.conv.to_string()).collect();
        write!(f, "Chain({})", links.join(", "))
    }
}
