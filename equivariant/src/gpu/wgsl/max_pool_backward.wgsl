// The gradient of a window goes to the first pixel, row-major, that holds the maximum.

alias Term = Field;

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

fn term(pixel: u32, tap: u32, row: u32, field: u32) -> Term {
    let v = transform(load_x(pixel, field));
    return hits(row, tap, field, v) * transform(load_dy(row, field));
}

fn store_sum(pixel: u32, field: u32, sum: Term) {
    store_dx(pixel, field, transform(sum));
}
