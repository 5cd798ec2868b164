// Patches of trivial channels, folded by parity: parity b is what leads to irrep b, so the folds of
// an orbit are one field. `folded` is [pixel of the batch, orbit, channel].

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let index = index_of(place);
    if index >= batch.samples * OUT_PIXELS * ORBITS * FIELDS {
        return;
    }
    let channel = index % FIELDS;
    let orbit = orbits[index / FIELDS % ORBITS];
    let row = index / (FIELDS * ORBITS);
    var taps: Field;
    for (var g = 0u; g < ORDER; g++) {
        taps[g] = seen(row, moved(orbit.tap, g), channel);
    }
    folded[row * ENTRIES + orbit.first + channel] = sums(taps) * orbit.scale;
}
