//! The passes of a convolution with products of bfloat16: what they round, and where sums go.
//!
//! Maps, parameters, gradients and sums stay in single precision. What a product reads is rounded
//! when it is packed: folds, not pixels, so a mirror changes signs and nothing else.

use pulp::NullaryFnOnce;
use pulp::x86::V4;

use crate::conv::backward::{Gathered, Products};
use crate::conv::finish::MOST_ROWS;
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

/// The product of a forward pass.
struct ForwardProduct<'a, const G: usize> {
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
    fn new(amx: Amx, conv: &Conv, params: &'a [f32], pieces: &mut Pieces<'a, f32>) -> Self {
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
            dy: pieces.zeros(MOST * sizes.steps_of_output * G),
            across: pieces.take(MOST / PAIRS * TILE * sizes.tiles),
            x: pieces.take(MOST / PAIRS * TILE * G),
            w,
            dw: pieces.take(TILE * sizes.gathers * sizes.tiles),
            adds: false,
            dx: pieces.take(MOST * G),
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

/// One orbit of taps of one block of channels.
struct Gather {
    orbit: usize,
    c: usize,
    folds: usize,
    /// The block of a folded patch that the first fold is, and blocks from one fold to the next.
    first: usize,
    step: usize,
}

impl Gather {
    /// They are numbered in the order in which passes take them.
    fn new(patches: &Patches, number: usize) -> Option<Gather> {
        let (orbit, c) = (number % patches.orbits(), number / patches.orbits());
        (c < patches.blocks()).then(|| {
            let range = patches.folded_of(orbit);
            Gather {
                orbit,
                c,
                folds: range.len() / patches.blocks(),
                first: range.start + c,
                step: patches.blocks(),
            }
        })
    }

    fn all(patches: &Patches) -> impl Iterator<Item = Gather> {
        (0..).map_while(|number| Gather::new(patches, number))
    }

    /// The block of a folded patch that a fold is.
    fn block(&self, fold: usize) -> Option<usize> {
        (fold < self.folds).then_some(self.first + fold * self.step)
    }

    /// The groups of a folded patch that the columns of a tile are: channel q of fold f is column
    /// q G + f.
    fn columns<const G: usize>(&self) -> [Option<usize>; TILE] {
        std::array::from_fn(|column| Some(self.block(column % G)? * LANES / G + column / G))
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
