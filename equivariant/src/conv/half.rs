//! The passes of a convolution with products of bfloat16: what they round, and where sums go.
//!
//! Maps, parameters, gradients and sums stay in single precision. What a product reads is rounded
//! when it is packed: folds, not pixels, so a mirror changes signs and nothing else.

mod backward;
mod forward;
mod gather;

use pulp::NullaryFnOnce;
use pulp::x86::V4;

use crate::conv::finish::MOST_ROWS;
use crate::conv::geometry::Conv;
use crate::conv::half::backward::BackwardProducts;
use crate::conv::half::forward::ForwardProduct;
use crate::conv::load::MOST;
use crate::conv::maps::Maps;
use crate::conv::pass::{Backward, Forward};
use crate::order::with_order;
use crate::simd::amx::{Amx, PAIRS, TILE};

/// Rows that a forward pass takes at a time.
const FORWARD: usize = MOST_ROWS;

/// What the processor has for it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Instructions {
    simd: V4,
    amx: Amx,
}

impl Instructions {
    pub fn new() -> Option<Instructions> {
        let (simd, amx) = (V4::try_new()?, Amx::new()?);
        Some(Instructions { simd, amx })
    }

    pub fn forward(self, pass: Forward<f32>) {
        self.simd.vectorize(Work { on: self, pass });
    }

    pub fn backward(self, pass: Backward<f32>) {
        self.simd.vectorize(Work { on: self, pass });
    }
}

struct Work<P> {
    on: Instructions,
    pass: P,
}

impl NullaryFnOnce for Work<Forward<'_, f32>> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Work { on, pass } = self;
        if let (Some(lines), Maps::Channels(x)) = (pass.conv.patches.lines(), pass.x) {
            return pass.run_lines(on.simd, lines, x);
        }
        with_order!(
            G = pass.conv.weights.order(),
            pass.run_products::<_, _, G>(on.simd, |conv, params, pieces| {
                ForwardProduct::<G>::new(on.amx, conv, params, pieces)
            })
        );
    }
}

impl NullaryFnOnce for Work<Backward<'_, f32>> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Work { on, pass } = self;
        let lines = pass.conv.patches.lines();
        if let (Some(lines), Maps::Channels(x), None) = (lines, pass.x, &pass.dx) {
            return pass.run_lines(on.simd, lines, x);
        }
        with_order!(
            G = pass.conv.weights.order(),
            pass.run_products::<_, _, G>(on.simd, |pass, pieces| {
                BackwardProducts::<G>::new(on, pass, pieces)
            })
        );
    }
}

/// How many steps and tiles the products of a convolution have.
#[derive(Clone, Copy)]
struct Sizes {
    /// Blocks of an output pixel.
    width: usize,
    /// Tiles of an output pixel, one for each irrep.
    tiles: usize,
    /// Steps of a product over an output pixel.
    steps_of_output: usize,
    /// Steps of a product over a folded patch, each of two gathers.
    steps_of_patch: usize,
    /// Orbits of taps, each of a block of channels.
    gathers: usize,
}

impl Sizes {
    fn new(conv: &Conv) -> Sizes {
        let (order, width) = (conv.weights.order(), conv.weights.width());
        let patches = &conv.patches;
        Sizes {
            width,
            tiles: width.div_ceil(order) * order,
            steps_of_output: width.div_ceil(2 * order),
            steps_of_patch: (patches.orbits() * patches.blocks()).div_ceil(2),
            gathers: patches.orbits() * patches.blocks(),
        }
    }
}

/// Blocks that a forward pass takes beyond those of single precision.
pub(crate) fn forward_blocks(conv: &Conv) -> usize {
    let sizes = Sizes::new(conv);
    let (order, steps) = (conv.weights.order(), sizes.steps_of_patch);
    let tiles = steps * (FORWARD / TILE * order + sizes.tiles) + FORWARD / TILE * sizes.tiles;
    TILE * tiles + conv.weights.blocks() + FORWARD * (2 * order + 2 * sizes.width)
}

/// Blocks that a backward pass takes.
pub(crate) fn backward_blocks(conv: &Conv) -> usize {
    let sizes = Sizes::new(conv);
    let (order, weights) = (conv.weights.order(), &conv.weights);
    let of_rows = MOST / TILE * sizes.steps_of_output * order;
    let across = MOST / PAIRS * (sizes.tiles + order);
    let of_weights = sizes.gathers * (sizes.tiles + sizes.steps_of_output * order);
    TILE * (of_rows + across + of_weights) + MOST * order + weights.blocks()
}
