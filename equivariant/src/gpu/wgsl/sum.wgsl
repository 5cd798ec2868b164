// Adds up partial gradients `[part, value]` in the order of the parts.

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let index = index_of(place);
    if index >= LEN {
        return;
    }
    var sum = 0.0;
    for (var part = 0u; part < parts(); part++) {
        sum += partial[part * LEN + index];
    }
    gradient[BASE + index] = sum;
}
