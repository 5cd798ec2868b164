//! The passes of a convolution with products of bfloat16: what they round, and where sums go.
//!
//! Maps, parameters, gradients and sums stay in single precision. What a product reads is rounded
//! when it is packed: folds, not pixels, so a mirror changes signs and nothing else.

use pulp::NullaryFnOnce;
use pulp::x86::V4;

use crate::conv::backward::{Gathered, Products};
use crate::conv::forward::Product;
use crate::conv::geometry::Conv;
use crate::conv::load::{Buffers, MOST};
use crate::conv::maps::Maps;
use crate::conv::pass::{Backward, Forward};
use crate::conv::pieces::Pieces;
use crate::order::with_order;
use crate::simd::amx::{Amx, Factors, PAIRS, TILE, Tiles};
use crate::simd::lanes::{Block, LANES, Lanes};
use crate::simd::patches::Patches;
use crate::simd::tiles::ROWS;

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
    /// Steps of a product over a folded patch.
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
            steps_of_patch: patches.folded().div_ceil(2 * order),
            gathers: patches.orbits() * patches.blocks(),
        }
    }
}

/// Blocks that a forward pass takes.
pub(crate) fn forward_blocks(conv: &Conv) -> usize {
    let sizes = Sizes::new(conv);
    let (order, steps) = (conv.weights.order(), sizes.steps_of_patch);
    TILE * (steps * (order + sizes.tiles) + sizes.tiles) + conv.weights.blocks()
}

/// Blocks that a backward pass takes.
pub(crate) fn backward_blocks(conv: &Conv) -> usize {
    let sizes = Sizes::new(conv);
    let (order, weights) = (conv.weights.order(), &conv.weights);
    let of_rows = MOST / TILE * sizes.steps_of_output * order;
    let across = MOST / PAIRS * (sizes.tiles + order);
    let of_weights = sizes.gathers * (sizes.tiles + sizes.steps_of_output * order);
    TILE * (of_rows + across + of_weights + order) + weights.blocks()
}

/// The product of a forward pass.
struct ForwardProduct<'a, const G: usize> {
    amx: Amx,
    on: Tiles,
    sizes: Sizes,
    x: &'a mut [Block<f32>],
    w: &'a [Block<f32>],
    sums: &'a mut [Block<f32>],
}

impl<'a, const G: usize> ForwardProduct<'a, G> {
    fn new(amx: Amx, conv: &Conv, params: &'a [f32], pieces: &mut Pieces<'a, f32>) -> Self {
        let sizes = Sizes::new(conv);
        let packed = conv.weights.packed(params, pieces, true);
        let w = pieces.take(TILE * sizes.steps_of_patch * sizes.tiles);
        amx.pack_weights::<G>(packed, sizes.width, w);
        ForwardProduct {
            amx,
            on: amx.tiles(),
            sizes,
            // rows that a panel lacks are multiplied like the others, and nobody reads their sums
            x: pieces.zeros(TILE * sizes.steps_of_patch * G),
            w,
            sums: pieces.take(TILE * sizes.tiles),
        }
    }
}

impl<const G: usize> Product<f32> for ForwardProduct<'_, G> {
    #[inline(always)]
    fn run(&mut self, panel: &[Block<f32>], sums: &mut [Block<f32>], rows: usize) {
        self.amx.pack_rows::<G>(panel, ROWS, ROWS, self.x);
        let factors = Factors {
            a: self.x,
            of_a: G,
            b: self.w,
            of_b: self.sizes.tiles,
            steps: self.sizes.steps_of_patch,
        };
        self.on.multiply(factors, self.sums, false);
        let sums = &mut sums[..rows * self.sizes.width];
        self.amx.unpack_rows::<G>(self.sums, rows, sums);
    }
}

/// The products of a backward pass.
struct BackwardProducts<'a, const G: usize> {
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
    fn new(on: Instructions, pass: &Backward<'a, f32>, pieces: &mut Pieces<'a, f32>) -> Self {
        let Instructions { simd, amx } = on;
        let conv = pass.conv;
        let sizes = Sizes::new(conv);
        let w = pass.dx.is_some().then(|| {
            let packed = conv.weights.packed(pass.params, pieces, true);
            let len = TILE * sizes.steps_of_output * G;
            let w = pieces.take(sizes.gathers * len);
            for (w, at) in w.chunks_exact_mut(len).zip(gathers::<G>(&conv.patches)) {
                amx.pack_transposed::<G>(packed, sizes.width, at, w);
            }
            &*w
        });
        BackwardProducts {
            lanes: simd,
            amx,
            on: amx.tiles(),
            sizes,
            rows: 0,
            dy: pieces.zeros(MOST * sizes.steps_of_output * G),
            across: pieces.take(MOST / PAIRS * TILE * sizes.tiles),
            x: pieces.take(MOST / PAIRS * TILE * G),
            w,
            dw: pieces.take(TILE * sizes.gathers * sizes.tiles),
            adds: false,
            dx: pieces.take(TILE * G),
        }
    }
}

impl<const G: usize> Products<f32, V4> for BackwardProducts<'_, G> {
    const ROWS: usize = MOST;

    #[inline(always)]
    fn load(&mut self, dy: &[Block<f32>], rows: usize) {
        self.adds = self.rows > 0;
        self.rows = rows;
        self.amx.pack_across::<G>(dy, rows, self.across);
        if self.w.is_some() {
            self.amx.pack_rows::<G>(dy, rows, rows, self.dy);
        }
    }

    #[inline(always)]
    fn weights(&mut self, of: &Gathered, buffers: &mut Buffers<f32>) {
        let Sizes { tiles, .. } = self.sizes;
        let panel = &buffers.panel[..of.folds() * self.rows];
        self.amx.pack_pairs::<G>(panel, self.rows, self.x);
        let factors = Factors {
            a: self.across,
            of_a: tiles,
            b: self.x,
            of_b: G,
            steps: self.rows.div_ceil(PAIRS),
        };
        let len = TILE * tiles;
        let dw = &mut self.dw[of.number() * len..][..len];
        self.on.multiply(factors, dw, self.adds);
    }

    #[inline(always)]
    fn input(&mut self, of: &Gathered, buffers: &mut Buffers<f32>, gradient: &mut [f32]) {
        let steps = self.sizes.steps_of_output;
        let len = TILE * steps * G;
        let Some(w) = self.w else { return };
        let w = &w[of.number() * len..][..len];
        for (dy, windows) in self.dy.chunks_exact(len).zip(of.windows.chunks(TILE)) {
            let factors = Factors {
                a: dy,
                of_a: G,
                b: w,
                of_b: G,
                steps,
            };
            self.on.multiply(factors, self.dx, false);
            let panel = &mut buffers.panel[..of.folds() * windows.len()];
            self.amx.unpack_columns::<G>(self.dx, windows.len(), panel);
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
        for (sums, at) in sums.zip(gathers::<G>(&conv.patches)) {
            self.amx.add_transposed::<G>(sums, at, dw, width);
        }
    }
}

/// For each orbit and block of channels, the groups of a folded patch that its columns are: channel
/// q of fold f is column q G + f.
fn gathers<const G: usize>(patches: &Patches) -> impl Iterator<Item = [Option<usize>; TILE]> {
    let blocks = patches.blocks();
    (0..patches.orbits() * blocks).map(move |number| {
        let range = patches.folded_of(number / blocks);
        std::array::from_fn(|column| {
            let block = range.start + column % G * blocks + number % blocks;
            (block < range.end).then_some(block * LANES / G + column / G)
        })
    })
}

impl Gathered<'_> {
    /// Its number in [`gathers`].
    #[inline(always)]
    fn number(&self) -> usize {
        self.orbit * self.conv.patches.blocks() + self.c
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
