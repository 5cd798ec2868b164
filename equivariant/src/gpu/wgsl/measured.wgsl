// The mean and one over the standard deviation of a field over a part of the batch.
fn standard_of(part: u32, field: u32, place: Place) -> vec2<f32> {
    var sum = 0.0;
    for (var i = place.thread; i < pixels(); i += THREADS) {
        sum += first_of(load_x(part * pixels() + i, field));
    }
    var mean = summed(sum, place) / f32(pixels());
    if field >= CENTRED {
        mean = 0.0;
    }
    var squares = 0.0;
    for (var i = place.thread; i < pixels(); i += THREADS) {
        let v = load_x(part * pixels() + i, field) - first(mean);
        squares += total(v * v);
    }
    let variance = summed(squares, place) / f32(pixels() * ORDER);
    return vec2(mean, inverseSqrt(variance + EPSILON));
}
