// ReLU in the regular basis.

fn run(pixel: u32, field: u32) {
    let v = transform(load_x(pixel, field));
    store_y(pixel, field, transform(masked(v, passing(v))));
}
