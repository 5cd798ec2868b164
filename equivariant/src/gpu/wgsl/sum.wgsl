// Adds up partial gradients `[part, value]` in the order of the parts.

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let index = index_of(place);
    if index >= LEN {
        return;
    }
    var sum = 0.0;
    var part = 0u;
    // four at a time, so that loads do not wait for one another
    for (; part + 4u <= parts(); part += 4u) {
        let at = part * LEN + index;
        let next = vec4(partial[at], partial[at + LEN], partial[at + 2u * LEN], partial[at + 3u * LEN]);
        sum = (((sum + next.x) + next.y) + next.z) + next.w;
    }
    for (; part < parts(); part++) {
        sum += partial[part * LEN + index];
    }
    gradient[BASE + index] = sum;
}
