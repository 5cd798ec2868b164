// Normalises fields. `kept` holds the mean and one over the standard deviation, `[part, field]`.

fn run(group: u32, place: Place) {
    let field = group % FIELDS;
    let start = group / FIELDS * pixels();
    let standard = standard_of(group / FIELDS, field, place);
    if place.thread == 0u {
        kept[group] = standard;
    }
    let gain = params[BASE + field];
    var bias = 0.0;
    if field < CENTRED {
        bias = params[BASE + FIELDS + field];
    }
    for (var i = place.thread; i < pixels(); i += THREADS) {
        let v = standardised(start + i, field, standard);
        store_y(start + i, field, gain * v + first(bias));
    }
}
