// Products of matrices of fields, which multiply number by number: one product for each irrep.
//
// put(r, c) gets the sum over d of left_at(r, d) right_at(d, c), in the order of d. A group of
// threads makes a tile of rows and columns, for one slice of the sum.

const TILE_ROWS = ROW_THREADS * ROWS_EACH;
const TILE_COLS = COL_THREADS * COLS_EACH;

var<workgroup> left: array<Field, TILE_DEPTH * TILE_ROWS>;
var<workgroup> right: array<Field, TILE_DEPTH * TILE_COLS>;

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let group = group_of(place);
    let col_tiles = (COLS + TILE_COLS - 1u) / TILE_COLS;
    let first_col = group % col_tiles * TILE_COLS;
    let slice = group / col_tiles % SLICES;
    let first_row = group / (col_tiles * SLICES) * TILE_ROWS;
    let share = (depth() + SLICES - 1u) / SLICES;
    let end = min(depth(), (slice + 1u) * share);
    let row = place.thread / COL_THREADS;
    let col = place.thread % COL_THREADS;
    var made: array<array<Field, COLS_EACH>, ROWS_EACH>;
    for (var start = slice * share; start < end; start += TILE_DEPTH) {
        for (var i = place.thread; i < TILE_DEPTH * TILE_ROWS; i += THREADS) {
            // neighbouring threads load neighbouring values
            let r = select(i / TILE_DEPTH, i % TILE_ROWS, ROWS_ARE_NEIGHBOURS);
            let d = select(i % TILE_DEPTH, i / TILE_ROWS, ROWS_ARE_NEIGHBOURS);
            var value = Field();
            if first_row + r < rows() && start + d < end {
                value = left_at(first_row + r, start + d);
            }
            left[d * TILE_ROWS + r] = value;
        }
        for (var i = place.thread; i < TILE_DEPTH * TILE_COLS; i += THREADS) {
            let c = i % TILE_COLS;
            let d = i / TILE_COLS;
            var value = Field();
            if first_col + c < COLS && start + d < end {
                value = right_at(start + d, first_col + c);
            }
            right[i] = value;
        }
        workgroupBarrier();
        for (var d = 0u; d < TILE_DEPTH; d++) {
            var b: array<Field, COLS_EACH>;
            for (var j = 0u; j < COLS_EACH; j++) {
                b[j] = right[d * TILE_COLS + col + j * COL_THREADS];
            }
            for (var i = 0u; i < ROWS_EACH; i++) {
                let a = left[d * TILE_ROWS + row + i * ROW_THREADS];
                for (var j = 0u; j < COLS_EACH; j++) {
                    made[i][j] = fma(a, b[j], made[i][j]);
                }
            }
        }
        workgroupBarrier();
    }
    for (var i = 0u; i < ROWS_EACH; i++) {
        let r = first_row + row + i * ROW_THREADS;
        for (var j = 0u; j < COLS_EACH; j++) {
            let c = first_col + col + j * COL_THREADS;
            if r < rows() && c < COLS {
                put(slice, r, c, made[i][j]);
            }
        }
    }
}
