// The average over a window; padding counts as zeros.

fn run(row: u32, field: u32) {
    var sum = Field();
    for (var i = 0u; i < SIZE * SIZE; i++) {
        let pixel = pixel_at(row, vec2(i / SIZE, i % SIZE));
        if pixel >= 0 {
            sum += load_x(u32(pixel), field) * SCALE;
        }
    }
    store_y(row, field, sum);
}
