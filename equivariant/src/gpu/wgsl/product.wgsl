// Products of matrices of fields, which multiply number by number: one product for each irrep.
//
// put(r, c) gets the sum over d of left_at(r, d) right_at(d, c), in the order of d. A group of
// threads makes a tile of rows and columns, for one slice of the sum. The next part of the factors
// is loaded while the last is multiplied. product.rs writes out the loops over a thread's values,
// which keeps them in registers.

const TILE_ROWS = ROW_THREADS * ROWS_EACH;
const TILE_COLS = COL_THREADS * COLS_EACH;
// one more, so that neighbouring columns are in different banks
const LEFT_STRIDE = TILE_ROWS + 1u;

var<workgroup> left: array<Field, TILE_DEPTH * LEFT_STRIDE>;
var<workgroup> right: array<Field, TILE_DEPTH * TILE_COLS>;

// Neighbouring threads load neighbouring values.
fn left_row(i: u32) -> u32 {
    return select(i / TILE_DEPTH, i % TILE_ROWS, ROWS_ARE_NEIGHBOURS);
}

fn left_depth(i: u32) -> u32 {
    return select(i % TILE_DEPTH, i / TILE_ROWS, ROWS_ARE_NEIGHBOURS);
}

fn load_left(first_row: u32, start: u32, end: u32, i: u32) -> Field {
    let r = first_row + left_row(i);
    let d = start + left_depth(i);
    if r < rows() && d < end {
        return left_at(r, d);
    }
    return Field();
}

fn load_right(first_col: u32, start: u32, end: u32, i: u32) -> Field {
    let c = first_col + i % TILE_COLS;
    let d = start + i / TILE_COLS;
    if i < TILE_DEPTH * TILE_COLS && c < COLS && d < end {
        return right_at(d, c);
    }
    return Field();
}

fn put_inside(slice: u32, r: u32, c: u32, v: Field) {
    if r < rows() && c < COLS {
        put(slice, r, c, v);
    }
}

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let group = group_of(place);
    let col_tiles = (COLS + TILE_COLS - 1u) / TILE_COLS;
    let first_col = group % col_tiles * TILE_COLS;
    let slice = group / col_tiles % SLICES;
    let first_row = group / (col_tiles * SLICES) * TILE_ROWS;
    let share = (depth() + SLICES - 1u) / SLICES;
    let first = slice * share;
    let end = min(depth(), first + share);
    let thread = place.thread;
    let row = thread / COL_THREADS;
    let col = thread % COL_THREADS;
DECLARE
    var start = first;
LOAD
    while start < end {
        workgroupBarrier();
STORE
        workgroupBarrier();
        start += TILE_DEPTH;
LOAD
MULTIPLY
    }
PUT
}
