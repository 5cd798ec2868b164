// A thread for each pixel and field, which runs what the kernel does to them.

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let index = index_of(place);
    if index < batch.samples * PIXELS * FIELDS {
        run(index / FIELDS, index % FIELDS);
    }
}
