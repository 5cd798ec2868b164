// The gradient goes to the first of the largest numbers.

fn run(pixel: u32, field: u32) {
    let hit = first_largest(transform(load_x(pixel, field)));
    store_dx(pixel, field, transform(hit * first_of(load_dy(pixel, field))));
}
