// The gradient of the expected positions: a thread for each pixel and field.

fn run(pixel: u32, field: u32) {
    let sample = pixel / PIXELS;
    let group = sample * FIELDS + field;
    let v = (transform(load_x(pixel, field)) - kept[4u * group]) * SCALE;
    let share = exp(v) / kept[4u * group + 1u];
    let at = position(pixel % PIXELS);
    let x = (at.x - kept[4u * group + 2u]) * SIGNS_X * transform(load_dy_x(sample, field));
    let y = (at.y - kept[4u * group + 3u]) * SIGNS_Y * transform(load_dy_y(sample, field));
    store_dx(pixel, field, transform(share * SCALE * (x + y)));
}
