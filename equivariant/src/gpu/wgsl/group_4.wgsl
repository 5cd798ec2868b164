// A field of four elements: a number for each irrep, or for each element.

alias Field = vec4<f32>;

const ORDER = 4u;

// The Walsh-Hadamard transform without its factor.
fn sums(v: Field) -> Field {
    let pairs = vec4(v.x + v.y, v.x - v.y, v.z + v.w, v.z - v.w);
    return vec4(pairs.xy + pairs.zw, pairs.xy - pairs.zw);
}

// The orthonormal Walsh-Hadamard transform, its own inverse.
fn transform(v: Field) -> Field {
    return sums(v) * 0.5;
}

const BITS = vec4(1u, 2u, 4u, 8u);

// A bit for each number that a ReLU lets pass: what is above zero, or not a number.
fn passing(v: Field) -> u32 {
    let on = select(BITS, vec4<u32>(), v <= Field());
    return on.x | on.y | on.z | on.w;
}

// The numbers whose bits are set, and zeros.
fn masked(v: Field, mask: u32) -> Field {
    return select(Field(), v, (BITS & vec4(mask)) != vec4<u32>());
}

// The sums over elements, of fields that are given for each of them.
fn sums_of(v: array<Field, ORDER>) -> array<Field, ORDER> {
    let a = v[0] + v[1];
    let b = v[0] - v[1];
    let c = v[2] + v[3];
    let d = v[2] - v[3];
    return array<Field, ORDER>(a + c, b + d, a - c, b - d);
}

// The number of irrep b from where that of irrep b times `parity` was.
fn swapped(v: Field, parity: u32) -> Field {
    let x = select(v, v.yxwz, (parity & 1u) != 0u);
    return select(x, x.zwxy, (parity & 2u) != 0u);
}

// A field whose first number is this and whose others are zero.
fn first(value: f32) -> Field {
    return Field(value, 0.0, 0.0, 0.0);
}

fn first_of(v: Field) -> f32 {
    return v.x;
}

fn total(v: Field) -> f32 {
    return (v.x + v.y) + (v.z + v.w);
}

fn largest(v: Field) -> f32 {
    return max(max(v.x, v.y), max(v.z, v.w));
}

// 1 at the first of the largest numbers, 0 elsewhere.
fn first_largest(v: Field) -> Field {
    let hit = v == Field(largest(v));
    let y = hit.y && !hit.x;
    let z = hit.z && !(hit.x || hit.y);
    let w = hit.w && !(hit.x || hit.y || hit.z);
    return select(Field(), Field(1.0), vec4(hit.x, y, z, w));
}
