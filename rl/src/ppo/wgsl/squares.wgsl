// Sums of squares of the gradient, one for each group.

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    var sum = 0.0;
    for (var i = index_of(place); i < PARAMS; i += GROUPS * THREADS) {
        sum += gradient[i] * gradient[i];
    }
    let total = summed(sum, place);
    if place.thread == 0u {
        squares[group_of(place)] = total;
    }
}
