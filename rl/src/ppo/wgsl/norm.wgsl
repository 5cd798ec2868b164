// The norm of the gradient, and the factor that clips it. One group.

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let norm = sqrt(summed(squares[place.thread], place));
    if place.thread == 0u && log[0] == RUNNING {
        let row = ROW * (batch.index + 1u);
        log[row + 6u] = norm;
        if is_finite(norm) {
            log[1] = select(1.0, MAX_NORM / norm, norm > MAX_NORM);
            log[row + 7u] = 1.0;
        } else {
            log[0] = NORM_NOT_FINITE;
        }
    }
}
