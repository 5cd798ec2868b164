// The gradient of ReLU.

fn run(pixel: u32, field: u32) {
    let gate = transform(load_x(pixel, field));
    store_dx(pixel, field, transform(passed(gate, transform(load_dy(pixel, field)))));
}
