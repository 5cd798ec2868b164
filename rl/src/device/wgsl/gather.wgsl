// The observations of a batch: a thread for each byte and component. Bytes become numbers in
// [-0.5, 0.5].

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let index = index_of(place);
    if index >= batch.samples * (IMAGE + VECTOR) {
        return;
    }
    let slot = index / (IMAGE + VECTOR);
    let i = index % (IMAGE + VECTOR);
    let decision = samples[batch.start + slot].decision;
    if i < IMAGE {
        let at = decision * IMAGE + i;
        let byte = (images[at / 4u] >> (8u * (at % 4u))) & 255u;
        x_image[slot * IMAGE + i] = f32(byte) * (1.0 / 255.0) - 0.5;
    } else {
        x_vector[slot * VECTOR + i - IMAGE] = vectors[decision * VECTOR + i - IMAGE];
    }
}
