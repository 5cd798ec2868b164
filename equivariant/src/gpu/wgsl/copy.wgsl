// Copies fields.

fn run(pixel: u32, field: u32) {
    store_y(pixel, field, load_x(pixel, field));
}
