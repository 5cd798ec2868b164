// Normalises fields: a group of threads for each part of the batch that shares statistics, and each
// field. `kept` holds the mean and one over the standard deviation, `[part, field]`.

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let group = group_of(place);
    let field = group % FIELDS;
    let part = group / FIELDS;
    if part >= parts() {
        return;
    }
    let standard = standard_of(part, field, place.thread);
    if place.thread == 0u {
        kept[group] = standard;
    }
    let gain = params[BASE + field];
    let centred = field < CENTRED;
    for (var i = place.thread; i < pixels(); i += THREADS) {
        let pixel = part * pixels() + i;
        let v = (load_x(pixel, field) - first(standard.x)) * standard.y;
        var bias = 0.0;
        if centred {
            bias = params[BASE + FIELDS + field];
        }
        store_y(pixel, field, gain * v + first(bias));
    }
}
