// Folds of trivial channels: parity b is what leads to irrep b, so those of an orbit are one field.
// `folded` is [pixel of the batch, orbit, channel].

alias Taps = Field;

fn fold(taps: Taps, orbit: Orbit, at: u32) {
    folded[at] = sums(taps) * orbit.scale;
}
