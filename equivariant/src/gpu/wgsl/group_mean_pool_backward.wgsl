// The gradient of the mean of a field.

fn run(pixel: u32, field: u32) {
    store_dx(pixel, field, first(first_of(load_dy(pixel, field)) * SCALE));
}
