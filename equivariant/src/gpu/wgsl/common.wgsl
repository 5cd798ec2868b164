// What every kernel has: the batch, and what follows from a thread's place in it.

struct Batch {
    samples: u32,
    // what the program that runs it means by them
    start: u32,
    index: u32,
    numbers: vec4<f32>,
}

@group(0) @binding(0) var<uniform> batch: Batch;

const THREADS = 64u;

// Groups fill a plane, since a line of them is limited.
fn group_of(place: Place) -> u32 {
    return place.group.y * place.groups.x + place.group.x;
}

fn index_of(place: Place) -> u32 {
    return group_of(place) * THREADS + place.thread;
}

// The sign of an irrep at an element, both by their positions in the group's lists.
fn sign_of(irrep: u32, element: u32) -> f32 {
    return 1.0 - 2.0 * f32(countOneBits(irrep & element) & 1u);
}
