// A field of two elements: a number for each irrep, or for each element.

alias Field = vec2<f32>;

const ORDER = 2u;

// The Walsh-Hadamard transform without its factor.
fn sums(v: Field) -> Field {
    return Field(v.x + v.y, v.x - v.y);
}

// The orthonormal Walsh-Hadamard transform, its own inverse.
fn transform(v: Field) -> Field {
    return sums(v) * 0.70710678118654752;
}

const BITS = vec2(1u, 2u);

// A bit for each number that a ReLU lets pass: what is above zero, or not a number.
fn passing(v: Field) -> u32 {
    let on = select(BITS, vec2<u32>(), v <= Field());
    return on.x | on.y;
}

// The numbers whose bits are set, and zeros.
fn masked(v: Field, mask: u32) -> Field {
    return select(Field(), v, (BITS & vec2(mask)) != vec2<u32>());
}

// The sums over elements, of fields that are given for each of them.
fn sums_of(v: array<Field, ORDER>) -> array<Field, ORDER> {
    return array<Field, ORDER>(v[0] + v[1], v[0] - v[1]);
}

// The number of irrep b from where that of irrep b times `parity` was.
fn swapped(v: Field, parity: u32) -> Field {
    return select(v, v.yx, parity == 1u);
}

// A field whose first number is this and whose others are zero.
fn first(value: f32) -> Field {
    return Field(value, 0.0);
}

fn first_of(v: Field) -> f32 {
    return v.x;
}

fn total(v: Field) -> f32 {
    return v.x + v.y;
}

fn largest(v: Field) -> f32 {
    return max(v.x, v.y);
}

// 1 at the first of the largest numbers, 0 elsewhere.
fn first_largest(v: Field) -> Field {
    let x = v.x >= v.y;
    return select(Field(0.0, 1.0), Field(1.0, 0.0), x);
}
