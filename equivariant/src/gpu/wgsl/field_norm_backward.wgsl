// The gradients of normalised fields. `partial` holds those of the parameters, `[part, parameter]`.

fn run(group: u32, place: Place) {
    let field = group % FIELDS;
    let part = group / FIELDS;
    let start = part * pixels();
    let standard = kept[group];
    var products = 0.0;
    var shifts = 0.0;
    for (var i = place.thread; i < pixels(); i += THREADS) {
        let d = load_dy(start + i, field);
        products += total(standardised(start + i, field, standard) * d);
        shifts += first_of(d);
    }
    products = summed(products, place);
    shifts = summed(shifts, place);
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
        let v = standardised(start + i, field, standard);
        let d = load_dy(start + i, field) - v * scaled - first(shifted);
        store_dx(start + i, field, factor * d);
    }
}
