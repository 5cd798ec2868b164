// The gradient in the input from that in the folded patches: a thread for each input pixel and
// field gathers from the windows that see it.

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let index = index_of(place);
    if index >= batch.samples * HEIGHT * WIDTH * FIELDS {
        return;
    }
    let field = index % FIELDS;
    let pixel = index / FIELDS;
    var sum = Field();
    for (var i = 0u; i < SIZE * SIZE; i++) {
        let window = window_at(pixel, vec2(i / SIZE, i % SIZE));
        if window < 0 {
            continue;
        }
        let tap = taps[i];
        var at = u32(window) * ENTRIES + tap.first + field;
        var value = Field();
        for (var p = 0u; p < ORDER; p++) {
            if (tap.parities & (1u << p)) != 0u {
                value += swapped(d_folded[at], p) * sign_of(p, tap.element);
                at += FIELDS;
            }
        }
        sum += value * tap.scale;
    }
    store_dx(pixel, field, sum);
}
