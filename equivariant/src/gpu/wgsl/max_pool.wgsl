// The largest number over a window, in the regular basis. Padding never wins.

fn run(row: u32, field: u32) {
    var best = Field();
    var found = false;
    for (var i = 0u; i < SIZE * SIZE; i++) {
        let pixel = pixel_at(row, vec2(i / SIZE, i % SIZE));
        if pixel < 0 {
            continue;
        }
        let v = transform(load_x(u32(pixel), field));
        if !found {
            best = v;
        }
        best = select(v, best, v <= best);
        found = true;
    }
    store_y(row, field, transform(best));
}
