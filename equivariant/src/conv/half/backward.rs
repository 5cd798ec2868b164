//! The products of a backward pass.

use pulp::x86::V4;

use crate::conv::backward::{Gathered, Products};
use crate::conv::geometry::Conv;
use crate::conv::half::gather::Gather;
use crate::conv::load::Buffers;
use crate::conv::pass::Backward;
use crate::conv::pieces::Pieces;
use crate::conv::sizes::{BACKWARD, Sizes};
use crate::half::Half;
use crate::simd::amx::{Amx, Factors, Tiles};
use crate::simd::lanes::{Block, LANES, Lanes, PAIRS, TILE};

/// The products of a backward pass.
pub(super) struct BackwardProducts<'a, const G: usize> {
    lanes: V4,
    amx: Amx,
    on: Tiles,
    sizes: Sizes,
    rows: usize,
    /// The output gradient, as the gradient of the input reads it.
    dy: &'a mut [Block<f32>],
    /// The output gradient, as the gradient of the weights reads it.
    across: &'a mut [Block<f32>],
    /// Folds.
    x: &'a mut [Block<f32>],
    /// Weights, unless nobody asks for the gradient of the input.
    w: Option<&'a [Block<f32>]>,
    /// The gradients of the weights.
    dw: &'a mut [Block<f32>],
    /// Whether they hold those of rows before.
    adds: bool,
    /// The gradient of folds.
    dx: &'a mut [Block<f32>],
}

impl<'a, const G: usize> BackwardProducts<'a, G> {
    pub fn new(on: Half, pass: &Backward<'a, f32>, pieces: &mut Pieces<'a, f32>) -> Self {
        let Half { simd, amx } = on;
        let conv = pass.conv;
        let sizes = Sizes::new(conv);
        let w = pass.dx.is_some().then(|| {
            let packed = conv.weights.packed(pass.params, pieces, true);
            let len = TILE * sizes.steps_of_output * G;
            let w = pieces.take(sizes.gathers * len);
            for (w, gather) in w.chunks_exact_mut(len).zip(Gather::all(&conv.patches)) {
                amx.pack_transposed::<G>(packed, sizes.width, gather.columns::<G>(), w);
            }
            &*w
        });
        BackwardProducts {
            lanes: simd,
            amx,
            on: amx.tiles(),
            sizes,
            rows: 0,
            dy: pieces.zeros(BACKWARD * sizes.steps_of_output * G),
            across: pieces.take(BACKWARD / PAIRS * TILE * sizes.tiles),
            x: pieces.take(BACKWARD / PAIRS * TILE * G),
            w,
            dw: pieces.take(TILE * sizes.gathers * sizes.tiles),
            adds: false,
            dx: pieces.take(BACKWARD * G),
        }
    }
}

impl<const G: usize> Products<f32, V4> for BackwardProducts<'_, G> {
    const ROWS: usize = BACKWARD;

    #[inline(always)]
    fn load(&mut self, dy: &[Block<f32>], rows: usize) {
        self.adds = self.rows > 0;
        self.rows = rows;
        self.amx.pack_across::<G>(dy, rows, self.across);
        if self.w.is_some() {
            let apart = TILE * self.sizes.steps_of_output * G;
            self.amx.pack_rows::<G>(dy, rows, apart, self.dy);
        }
    }

    #[inline(always)]
    fn weights(&mut self, of: &Gathered, buffers: &mut Buffers<f32>) {
        let Sizes { tiles, .. } = self.sizes;
        let panel = &buffers.panel[..of.folds() * self.rows];
        self.amx.pack_pairs::<G>(panel, self.rows, self.x);
        let factors = Factors {
            a: self.across,
            rows: tiles / G,
            a_apart: [G, tiles],
            b: self.x,
            columns: 1,
            b_apart: [G, G],
            steps: self.rows.div_ceil(PAIRS),
        };
        let len = TILE * tiles;
        let dw = &mut self.dw[of.number() * len..][..len];
        self.on.multiply::<G>(factors, dw, self.adds);
    }

    #[inline(always)]
    fn input(&mut self, of: &Gathered, buffers: &mut Buffers<f32>, gradient: &mut [f32]) {
        let steps = self.sizes.steps_of_output;
        let len = TILE * steps * G;
        let Some(w) = self.w else { return };
        let factors = Factors {
            a: self.dy,
            rows: self.rows.div_ceil(TILE),
            a_apart: [steps * G, G],
            b: &w[of.number() * len..][..len],
            columns: 1,
            b_apart: [G, G],
            steps,
        };
        self.on.multiply::<G>(factors, self.dx, false);
        let dx = self.dx.chunks_exact(TILE * G);
        for (dx, windows) in dx.zip(of.windows.chunks(TILE)) {
            let panel = &mut buffers.panel[..of.folds() * windows.len()];
            self.amx.unpack_columns::<G>(dx, windows.len(), panel);
            of.scatter(self.lanes, panel, windows, gradient);
        }
    }

    #[inline(always)]
    fn finish(self, conv: &Conv, dw: &mut [Block<f32>]) {
        let Sizes { tiles, width, .. } = self.sizes;
        if self.rows == 0 {
            return;
        }
        let sums = self.dw.chunks_exact(TILE * tiles);
        for (sums, gather) in sums.zip(Gather::all(&conv.patches)) {
            let at = gather.columns::<G>();
            self.amx.add_transposed::<G>(sums, at, dw, width);
        }
    }
}

impl Gathered<'_> {
    /// The number of the [`Gather`].
    #[inline(always)]
    fn number(&self) -> usize {
        self.c * self.conv.patches.orbits() + self.orbit
    }

    /// Adds the gradients of folds, `[fold][row]`, to that of the staged input.
    #[inline(always)]
    fn scatter(&self, lanes: V4, panel: &[Block<f32>], windows: &[usize], gradient: &mut [f32]) {
        let patches = &self.conv.patches;
        match (patches.replicated(), self.folds()) {
            (true, _) => {
                for (fold, window) in panel.iter().zip(windows) {
                    let at = window + self.c * LANES;
                    let fold = lanes.load(fold);
                    patches.scatter_replicated::<f32, V4>(lanes, self.orbit, fold, gradient, at);
                }
            }
            (false, 1) => self.scatter_folds::<1>(lanes, panel, windows, gradient),
            (false, 2) => self.scatter_folds::<2>(lanes, panel, windows, gradient),
            (false, _) => self.scatter_folds::<4>(lanes, panel, windows, gradient),
        }
    }

    #[inline(always)]
    fn scatter_folds<const N: usize>(
        &self,
        lanes: V4,
        panel: &[Block<f32>],
        windows: &[usize],
        gradient: &mut [f32],
    ) {
        let patches = &self.conv.patches;
        for (row, window) in windows.chunks(1).enumerate() {
            let mut folds = [lanes.splat(0.0); N];
            for (fold, panel) in folds.iter_mut().zip(panel.chunks_exact(windows.len())) {
                *fold = lanes.load(&panel[row]);
            }
            let (orbit, c) = (self.orbit, self.c);
            patches.scatter::<f32, V4, 1, N>(lanes, orbit, [folds], gradient, window, c);
        }
    }
}
