// The mean of a field in the regular basis.

fn run(pixel: u32, field: u32) {
    store_y(pixel, field, first(first_of(load_x(pixel, field)) * SCALE));
}
