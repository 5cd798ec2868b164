//! The products of a forward pass.

use pulp::x86::V4;

use crate::conv::forward::Product;
use crate::conv::geometry::Conv;
use crate::conv::half::gather::Gather;
use crate::conv::pieces::Pieces;
use crate::conv::sizes::{FORWARD, Sizes};
use crate::simd::amx::{Amx, Factors, Tiles};
use crate::simd::lanes::{Block, TILE};
use crate::simd::patches::Patches;

/// The product of a forward pass.
pub(super) struct ForwardProduct<'a, const G: usize> {
    amx: Amx,
    on: Tiles,
    sizes: Sizes,
    /// The folds of two gathers, `[gather][fold][row]`.
    panel: &'a mut [Block<f32>],
    x: &'a mut [Block<f32>],
    w: &'a [Block<f32>],
    sums: &'a mut [Block<f32>],
}

impl<'a, const G: usize> ForwardProduct<'a, G> {
    pub fn new(amx: Amx, conv: &Conv, params: &'a [f32], pieces: &mut Pieces<'a, f32>) -> Self {
        let sizes = Sizes::new(conv);
        let packed = conv.weights.packed(params, pieces, true);
        let w = pieces.zeros(TILE * sizes.steps_of_patch * sizes.tiles);
        for (step, w) in w.chunks_exact_mut(TILE * sizes.tiles).enumerate() {
            let at = std::array::from_fn(|b| {
                let gather = Gather::new(&conv.patches, 2 * step + b / G)?;
                gather.block(b % G).filter(|_| b < 2 * G)
            });
            amx.pack_weights::<G>(packed, sizes.width, at, w);
        }
        ForwardProduct {
            amx,
            on: amx.tiles(),
            sizes,
            panel: pieces.take(2 * G * FORWARD),
            x: pieces.take(FORWARD * sizes.steps_of_patch * G),
            w,
            sums: pieces.take(FORWARD * sizes.tiles),
        }
    }
}

impl<const G: usize> Product<f32, V4> for ForwardProduct<'_, G> {
    const ROWS: usize = FORWARD;

    #[inline(always)]
    fn gather(&mut self, lanes: V4, patches: &Patches, staged: &[f32], windows: &[usize]) {
        let apart = TILE * self.sizes.steps_of_patch * G;
        for step in 0..self.sizes.steps_of_patch {
            for (i, panel) in self.panel.chunks_exact_mut(G * FORWARD).enumerate() {
                let gather = Gather::new(patches, 2 * step + i);
                let folds = gather.as_ref().map_or(0, |gather| gather.folds);
                if let Some(Gather { orbit, c, .. }) = gather {
                    patches.gather(lanes, (orbit, c), staged, windows, panel, FORWARD);
                }
                // what is not there meets weights of zero, but might not be a number
                panel[folds * FORWARD..].as_flattened_mut().fill(0.0);
            }
            let x = &mut self.x[step * G * TILE..];
            self.amx.pack_rows::<G>(self.panel, FORWARD, apart, x);
        }
    }

    #[inline(always)]
    fn run(&mut self, sums: &mut [Block<f32>], rows: usize) {
        let (steps, tiles) = (self.sizes.steps_of_patch, self.sizes.tiles);
        let factors = Factors {
            a: self.x,
            rows: FORWARD / TILE,
            a_apart: [steps * G, G],
            b: self.w,
            columns: tiles / G,
            b_apart: [G, tiles],
            steps,
        };
        self.on.multiply::<G>(factors, self.sums, false);
        let sums = &mut sums[..rows * self.sizes.width];
        self.amx
            .unpack_rows::<G>(self.sums, FORWARD / TILE, rows, sums);
    }
}
