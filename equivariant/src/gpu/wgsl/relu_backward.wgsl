// The gradient of ReLU.

fn run(pixel: u32, field: u32) {
    let mask = passing(transform(load_x(pixel, field)));
    store_dx(pixel, field, transform(masked(transform(load_dy(pixel, field)), mask)));
}
