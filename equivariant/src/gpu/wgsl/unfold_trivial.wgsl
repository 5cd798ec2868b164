// The same for trivial channels, whose folds are one field.

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let index = index_of(place);
    if index >= batch.samples * HEIGHT * WIDTH * FIELDS {
        return;
    }
    let channel = index % FIELDS;
    let pixel = index / FIELDS;
    var sum = 0.0;
    for (var i = 0u; i < SIZE * SIZE; i++) {
        let window = window_at(pixel, vec2(i / SIZE, i % SIZE));
        if window < 0 {
            continue;
        }
        let tap = taps[i];
        let folds = d_folded[u32(window) * ENTRIES + tap.first + channel];
        var signs: Field;
        for (var b = 0u; b < ORDER; b++) {
            signs[b] = sign_of(b, tap.element);
        }
        sum += total(folds * signs) * tap.scale;
    }
    dx[index] = sum;
}
