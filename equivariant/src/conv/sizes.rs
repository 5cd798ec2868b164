//! How large the products of half precision are.

use crate::conv::geometry::Conv;
use crate::simd::lanes::{PAIRS, TILE};

/// Output pixels that a forward pass takes at a time.
pub(crate) const FORWARD: usize = 32;
/// Output pixels that a backward pass takes at a time.
pub(crate) const BACKWARD: usize = 64;

/// How many steps and tiles the products of a convolution have.
#[derive(Clone, Copy)]
pub(crate) struct Sizes {
    /// Blocks of an output pixel.
    pub width: usize,
    /// Tiles of an output pixel, one for each irrep.
    pub tiles: usize,
    /// Steps of a product over an output pixel.
    pub steps_of_output: usize,
    /// Steps of a product over a folded patch, each of two gathers.
    pub steps_of_patch: usize,
    /// Orbits of taps, each of a block of channels.
    pub gathers: usize,
}

impl Sizes {
    pub fn new(conv: &Conv) -> Sizes {
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

/// Blocks that a forward pass takes for half precision.
pub(crate) fn forward_blocks(conv: &Conv) -> usize {
    if conv.half.is_none() {
        return 0;
    }
    let sizes = Sizes::new(conv);
    let (order, steps) = (conv.weights.order(), sizes.steps_of_patch);
    let tiles = steps * (FORWARD / TILE * order + sizes.tiles) + FORWARD / TILE * sizes.tiles;
    TILE * tiles + conv.weights.blocks() + FORWARD * (2 * order + 2 * sizes.width)
}

/// Blocks that a backward pass takes for half precision.
pub(crate) fn backward_blocks(conv: &Conv) -> usize {
    if conv.half.is_none() {
        return 0;
    }
    let sizes = Sizes::new(conv);
    let (order, weights) = (conv.weights.order(), &conv.weights);
    let of_rows = BACKWARD / TILE * sizes.steps_of_output * order;
    let across = BACKWARD / PAIRS * (sizes.tiles + order);
    let of_weights = sizes.gathers * (sizes.tiles + sizes.steps_of_output * order);
    TILE * (of_rows + across + of_weights) + BACKWARD * order + weights.blocks()
}
