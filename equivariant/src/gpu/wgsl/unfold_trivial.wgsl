// Sum over taps for trivial channels, whose folds are one field.

alias Term = f32;

fn term(pixel: u32, i: u32, window: u32, channel: u32) -> Term {
    let tap = taps[i];
    let folds = d_folded[window * ENTRIES + tap.first + channel];
    var signs: Field;
    for (var b = 0u; b < ORDER; b++) {
        signs[b] = sign_of(b, tap.element);
    }
    return total(folds * signs) * tap.scale;
}

fn store_sum(pixel: u32, channel: u32, sum: Term) {
    dx[pixel * FIELDS + channel] = sum;
}
