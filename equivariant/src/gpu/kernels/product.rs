//! Products of matrices of fields on a GPU.

use crate::gpu::kernel_dispatch::{DynamicDim, KernelDispatch, WORKGROUP_THREADS, WorkgroupCount};

/// Number of terms of a matrix product's sums that a workgroup loads at once.
const TILE_DEPTH: usize = 8;
/// Number of columns of a matrix product that a thread computes.
const COLS_EACH: usize = 2;

/// Product of two matrices of fields on a GPU, whose operands `product.wgsl` reads through
/// functions.
#[derive(Clone, Copy, Debug)]
pub(super) struct MatrixProduct {
    pub order: usize,
    pub rows: DynamicDim,
    pub cols: usize,
    pub depth: DynamicDim,
    /// Number of parts into which the sums over `depth` are cut, computed by separate workgroups.
    pub num_slices: usize,
    /// `true` if the left factor is stored column by column, `false` if row by row.
    pub left_is_column_major: bool,
}

impl MatrixProduct {
    /// Returns the GPU kernel of the product, without its buffers and the functions that access
    /// them.
    pub fn kernel_dispatch(self, label: &'static str) -> KernelDispatch {
        let tile = self.tile();
        let work = WorkgroupCount::per_tile_of_rows(
            self.rows,
            tile.rows(),
            tile.col_tiles * self.num_slices,
        );
        let kernel = KernelDispatch::new(label, self.order, work).add_u32_constants([
            ("ROW_THREADS", tile.row_threads),
            ("COL_THREADS", tile.col_threads),
            ("ROWS_EACH", tile.rows_each),
            ("COLS_EACH", COLS_EACH),
            ("TILE_DEPTH", TILE_DEPTH),
            ("COLS", self.cols),
            ("SLICES", self.num_slices),
        ]);
        let neighbours = self.left_is_column_major;
        kernel
            .add_wgsl(&format!("const ROWS_ARE_NEIGHBOURS = {neighbours};"))
            .add_wgsl(&dim_function("rows", self.rows))
            .add_wgsl(&dim_function("depth", self.depth))
            .add_wgsl(&tile.text())
    }

    /// Returns the number of workgroups for each part of the sums, for a product with a fixed
    /// number of rows.
    pub fn workgroups_per_slice(self) -> usize {
        let tile = self.tile();
        WorkgroupCount::per_tile_of_rows(self.rows, tile.rows(), tile.col_tiles).num_workgroups(0)
    }

    fn tile(self) -> Tile {
        // a power of two, so that it divides the number of threads
        let col_threads = self.cols.div_ceil(COLS_EACH).next_power_of_two().min(8);
        let row_threads = WORKGROUP_THREADS / col_threads;
        // with few rows, large tiles would leave most of a GPU idle
        let most = match self.rows {
            DynamicDim::PerSample(0..=16) => 1,
            DynamicDim::PerSample(17..=64) => 2,
            DynamicDim::PerSample(_) => 4,
            DynamicDim::Fixed(rows) => rows.div_ceil(row_threads).next_power_of_two().min(4),
        };
        Tile {
            row_threads,
            col_threads,
            // at most 64 rows, which bounds the shared memory
            rows_each: col_threads.min(most),
            col_tiles: self.cols.div_ceil(col_threads * COLS_EACH),
        }
    }
}

/// Part of a matrix product that a workgroup computes.
#[derive(Clone, Copy)]
struct Tile {
    row_threads: usize,
    col_threads: usize,
    rows_each: usize,
    col_tiles: usize,
}

impl Tile {
    fn rows(self) -> usize {
        self.row_threads * self.rows_each
    }

    /// Returns the WGSL text of the product with the loops over a thread's values unrolled. Arrays
    /// with computed indices would be in memory, which made products up to 37 times slower on an
    /// H200.
    fn text(self) -> String {
        let results = || (0..self.rows_each).flat_map(|i| (0..COLS_EACH).map(move |j| (i, j)));
        let lefts = 0..(TILE_DEPTH * self.rows()).div_ceil(WORKGROUP_THREADS);
        let right_len = TILE_DEPTH * self.col_threads * COLS_EACH;
        let rights = 0..right_len.div_ceil(WORKGROUP_THREADS);
        let mut declare = String::new();
        let mut load = String::new();
        let mut store = String::new();
        for k in lefts {
            let at = k * WORKGROUP_THREADS;
            declare += &format!("var l{k} = Field();\n");
            load += &format!("l{k} = load_left(first_row, start, end, thread + {at}u);\n");
            store += &format!(
                "left[left_depth(thread + {at}u) * LEFT_STRIDE + left_row(thread + {at}u)] = l{k};\n"
            );
        }
        for k in rights {
            let at = k * WORKGROUP_THREADS;
            declare += &format!("var r{k} = Field();\n");
            load += &format!("r{k} = load_right(first_col, start, end, thread + {at}u);\n");
            store += &if at + WORKGROUP_THREADS <= right_len {
                format!("right[thread + {at}u] = r{k};\n")
            } else {
                format!("if thread < {}u {{ right[thread + {at}u] = r{k}; }}\n", right_len - at)
            };
        }
        let mut multiply = String::new();
        for d in 0..TILE_DEPTH {
            for j in 0..COLS_EACH {
                multiply += &format!(
                    "let b{d}_{j} = right[{d}u * TILE_COLS + col + {j}u * COL_THREADS];\n"
                );
            }
            for i in 0..self.rows_each {
                multiply += &format!(
                    "let a{d}_{i} = left[{d}u * LEFT_STRIDE + row + {i}u * ROW_THREADS];\n"
                );
                for j in 0..COLS_EACH {
                    multiply += &format!("m{i}_{j} = fma(a{d}_{i}, b{d}_{j}, m{i}_{j});\n");
                }
            }
        }
        let mut put = String::new();
        for (i, j) in results() {
            declare += &format!("var m{i}_{j} = Field();\n");
            put += &format!(
                "put_inside(slice, first_row + row + {i}u * ROW_THREADS, \
                 first_col + col + {j}u * COL_THREADS, m{i}_{j});\n"
            );
        }
        include_str!("../wgsl/product.wgsl")
            .replace("DECLARE", &declare)
            .replace("LOAD", &load)
            .replace("STORE", &store)
            .replace("MULTIPLY", &multiply)
            .replace("PUT", &put)
    }
}

/// Returns the text of a WGSL function `name` that returns the size `rows` for the current batch.
pub(super) fn dim_function(name: &str, rows: DynamicDim) -> String {
    format!("fn {name}() -> u32 {{ return {}; }}", rows.wgsl_expression())
}
