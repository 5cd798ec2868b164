// The largest number of a field in the regular basis.

fn run(pixel: u32, field: u32) {
    store_y(pixel, field, first(largest(transform(load_x(pixel, field)))));
}
