// Patches, folded by parity: a thread for each output pixel, orbit of taps and input field.
// `folded` is [pixel of the batch, orbit, parity, field].

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let index = index_of(place);
    if index >= batch.samples * OUT_PIXELS * ORBITS * FIELDS {
        return;
    }
    let field = index % FIELDS;
    let orbit = orbits[index / FIELDS % ORBITS];
    let row = index / (FIELDS * ORBITS);
    var taps: array<Field, ORDER>;
    for (var g = 0u; g < ORDER; g++) {
        taps[g] = seen(row, moved(orbit.tap, g), field);
    }
    let folds = sums_of(taps);
    var at = row * ENTRIES + orbit.first + field;
    for (var p = 0u; p < ORDER; p++) {
        if (orbit.parities & (1u << p)) != 0u {
            folded[at] = swapped(folds[p], p) * orbit.scale;
            at += FIELDS;
        }
    }
}
