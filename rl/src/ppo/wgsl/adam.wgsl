// A step of Adam, as `adam.rs` takes it: a thread for each parameter. `batch.numbers` holds the
// learning rates of encoder and heads divided by the bias correction of the first moment, and the
// root of the second moment's correction. Standard deviations are clamped to their floor.

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let i = index_of(place);
    if i >= PARAMS || log[0] != RUNNING {
        return;
    }
    let g = gradient[i] * log[1];
    let m = BETA_1 * first_moment[i] + (1.0 - BETA_1) * g;
    let v = BETA_2 * second_moment[i] + (1.0 - BETA_2) * g * g;
    first_moment[i] = m;
    second_moment[i] = v;
    let rate = select(batch.numbers.x, batch.numbers.y, i >= HEADS);
    var p = params[i] - rate * m / (sqrt(v) / batch.numbers.z + EPSILON);
    if i >= LOG_STD && i < LOG_STD + ACTION {
        p = max(p, FLOOR);
    }
    params[i] = p;
}
