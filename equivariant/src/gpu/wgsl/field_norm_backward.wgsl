// The gradients of normalised fields. `partial` holds those of the parameters, `[part, parameter]`.

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let group = group_of(place);
    let field = group % FIELDS;
    let part = group / FIELDS;
    if part >= parts() {
        return;
    }
    let standard = kept[group];
    var products = 0.0;
    var shifts = 0.0;
    for (var i = place.thread; i < pixels(); i += THREADS) {
        let pixel = part * pixels() + i;
        let v = (load_x(pixel, field) - first(standard.x)) * standard.y;
        let d = load_dy(pixel, field);
        products += total(v * d);
        shifts += first_of(d);
    }
    products = summed(products, place.thread);
    shifts = summed(shifts, place.thread);
    let centred = field < CENTRED;
    if place.thread == 0u {
        partial[part * LEN + field] = products;
        if centred {
            partial[part * LEN + FIELDS + field] = shifts;
        }
    }
    let scaled = DEPENDENT * products / f32(pixels() * ORDER);
    let shifted = select(0.0, DEPENDENT * shifts / f32(pixels()), centred);
    let factor = params[BASE + field] * standard.y;
    for (var i = place.thread; i < pixels(); i += THREADS) {
        let pixel = part * pixels() + i;
        let v = (load_x(pixel, field) - first(standard.x)) * standard.y;
        store_dx(pixel, field, factor * (load_dy(pixel, field) - v * scaled - first(shifted)));
    }
}
