// Folds of fields: `folded` is [pixel of the batch, orbit, parity, field].

alias Taps = array<Field, ORDER>;

fn fold(taps: Taps, orbit: Orbit, first: u32) {
    let folds = sums_of(taps);
    var at = first;
    for (var p = 0u; p < ORDER; p++) {
        if (orbit.parities & (1u << p)) != 0u {
            folded[at] = swapped(folds[p], p) * orbit.scale;
            at += FIELDS;
        }
    }
}
