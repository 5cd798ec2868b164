// The gradient in an input pixel from those in the folded patches of the windows that see it.

alias Term = Field;

fn term(pixel: u32, i: u32, window: u32, field: u32) -> Term {
    let tap = taps[i];
    var at = window * ENTRIES + tap.first + field;
    var value = Field();
    for (var p = 0u; p < ORDER; p++) {
        if (tap.parities & (1u << p)) != 0u {
            value += swapped(d_folded[at], p) * sign_of(p, tap.element);
            at += FIELDS;
        }
    }
    return value * tap.scale;
}
