// A field of one element: an ordinary channel.

alias Field = f32;

const ORDER = 1u;

fn sums(v: Field) -> Field {
    return v;
}

fn transform(v: Field) -> Field {
    return v;
}

fn passing(v: Field) -> u32 {
    return select(1u, 0u, v <= 0.0);
}

fn masked(v: Field, mask: u32) -> Field {
    return select(0.0, v, mask != 0u);
}

fn sums_of(v: array<Field, ORDER>) -> array<Field, ORDER> {
    return v;
}

fn swapped(v: Field, parity: u32) -> Field {
    return v;
}

fn first(value: f32) -> Field {
    return value;
}

fn first_of(v: Field) -> f32 {
    return v;
}

fn total(v: Field) -> f32 {
    return v;
}

fn largest(v: Field) -> f32 {
    return v;
}

fn first_largest(v: Field) -> Field {
    return 1.0;
}
