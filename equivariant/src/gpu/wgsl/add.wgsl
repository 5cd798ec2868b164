// The sum of two maps.

fn run(pixel: u32, field: u32) {
    store_y(pixel, field, load_a(pixel, field) + load_b(pixel, field));
}
