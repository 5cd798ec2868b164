// The gradient of a window goes to the first pixel, row-major, that holds the maximum: a thread for
// each input pixel and field looks at the windows that see it.

// 1 where a window's maximum is first found at this of its taps.
fn hits(row: u32, tap: u32, field: u32, v: Field) -> Field {
    var hit = Field(1.0);
    for (var i = 0u; i < SIZE * SIZE; i++) {
        let pixel = pixel_at(row, vec2(i / SIZE, i % SIZE));
        if pixel < 0 || i == tap {
            continue;
        }
        let other = transform(load_x(u32(pixel), field));
        if i < tap {
            hit *= select(Field(), Field(1.0), other < v);
        } else {
            hit *= select(Field(), Field(1.0), other <= v);
        }
    }
    return hit;
}

fn run(pixel: u32, field: u32) {
    let v = transform(load_x(pixel, field));
    var sum = Field();
    for (var i = 0u; i < SIZE * SIZE; i++) {
        let row = window_at(pixel, vec2(i / SIZE, i % SIZE));
        if row >= 0 {
            sum += hits(u32(row), i, field, v) * transform(load_dy(u32(row), field));
        }
    }
    store_dx(pixel, field, transform(sum));
}
