// A group of threads for each field of each part of the batch that shares statistics. `run` gets
// the index of both, `[part, field]`.

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let group = group_of(place);
    if group < parts() * FIELDS {
        run(group, place);
    }
}

// A number of a field, in standard deviations from its mean.
fn standardised(pixel: u32, field: u32, standard: vec2<f32>) -> Field {
    return (load_x(pixel, field) - first(standard.x)) * standard.y;
}
