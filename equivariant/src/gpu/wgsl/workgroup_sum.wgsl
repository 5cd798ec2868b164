
// Sums the values of a group of threads.

var<workgroup> shared_values: array<f32, THREADS>;

fn summed(value: f32, place: Place) -> f32 {
    shared_values[place.thread] = value;
    workgroupBarrier();
    for (var step = THREADS / 2u; step > 0u; step /= 2u) {
        if place.thread < step {
            let a = shared_values[place.thread];
            let b = shared_values[place.thread + step];
            shared_values[place.thread] = a + b;
        }
        workgroupBarrier();
    }
    let result = shared_values[0];
    workgroupBarrier();
    return result;
}
