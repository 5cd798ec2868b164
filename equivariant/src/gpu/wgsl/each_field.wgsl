// A thread for each pixel and field, which runs what the kernel does to them.

// Zero where the gate is at most zero: not a number stays visible.
fn passed(gate: Field, value: Field) -> Field {
    return select(value, Field(), gate <= Field());
}

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let index = index_of(place);
    if index < batch.samples * PIXELS * FIELDS {
        run(index / FIELDS, index % FIELDS);
    }
}
