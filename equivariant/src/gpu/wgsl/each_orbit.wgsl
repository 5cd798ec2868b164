// Inputs of an orbit of taps in an output pixel's window, which `fold` folds by parity.

fn run(place: u32, field: u32) {
    let orbit = orbits[place % ORBITS];
    let row = place / ORBITS;
    var taps: Taps;
    for (var g = 0u; g < ORDER; g++) {
        taps[g] = seen(row, moved(orbit.tap, g), field);
    }
    fold(taps, orbit, row * ENTRIES + orbit.first + field);
}
