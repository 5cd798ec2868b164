//! Products of matrices of fields.

use crate::gpu::step::{Rows, Step, THREADS, Work};

/// Numbers of a sum that a group of threads loads at once.
const TILE_DEPTH: usize = 8;
/// Columns of a thread.
const COLS_EACH: usize = 2;

/// A product; `product.wgsl` says what of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Product {
    pub order: usize,
    pub rows: Rows,
    pub cols: usize,
    pub depth: Rows,
    /// Parts of the sum that are made apart from one another.
    pub slices: usize,
    /// Whether the rows of the left factor, not its columns, are neighbours in memory.
    pub rows_are_neighbours: bool,
}

impl Product {
    /// The kernel, without its buffers and the functions that read and write them.
    pub fn step(self, label: &'static str) -> Step {
        let col_threads = self.cols.div_ceil(COLS_EACH).next_power_of_two().min(8);
        let row_threads = THREADS / col_threads;
        // a tile has at most 64 rows, which bounds the shared memory
        let rows_each = col_threads.min(4);
        let col_tiles = self.cols.div_ceil(col_threads * COLS_EACH);
        let work = Work::tiles(self.rows, row_threads * rows_each, col_tiles * self.slices);
        let step = Step::new(label, self.order, work).constants([
            ("ROW_THREADS", row_threads),
            ("COL_THREADS", col_threads),
            ("ROWS_EACH", rows_each),
            ("COLS_EACH", COLS_EACH),
            ("TILE_DEPTH", TILE_DEPTH),
            ("COLS", self.cols),
            ("SLICES", self.slices),
        ]);
        let neighbours = self.rows_are_neighbours;
        step.text(&format!("const ROWS_ARE_NEIGHBOURS = {neighbours};"))
            .text(&expression("rows", self.rows))
            .text(&expression("depth", self.depth))
            .text(include_str!("../wgsl/product.wgsl"))
    }
}

/// A function that gives a number of rows.
pub(super) fn expression(name: &str, rows: Rows) -> String {
    format!("fn {name}() -> u32 {{ return {}; }}", rows.expression())
}
