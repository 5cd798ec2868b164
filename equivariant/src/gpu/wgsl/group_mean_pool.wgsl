// The mean of a field in the regular basis.

fn run(pixel: u32, field: u32) {
    y[pixel * FIELDS + field] = first_of(load_x(pixel, field)) * SCALE;
}
