// The expected position of each number of a field in the regular basis, under the softmax over the
// pixels: a group of threads for each sample and field. `kept` holds the largest numbers, the sums
// of exponentials and the means of x and y, four fields for each.

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let group = group_of(place);
    let field = group % FIELDS;
    let sample = group / FIELDS;
    if sample >= batch.samples {
        return;
    }
    // threads beyond the pixels see the first pixel, which no maximum changes by
    var best = transform(load_x(sample * PIXELS, field));
    for (var i = place.thread; i < PIXELS; i += THREADS) {
        best = max(best, transform(load_x(sample * PIXELS + i, field)));
    }
    best = largest_of(best, place);
    var sum = Field();
    var x = Field();
    var y = Field();
    for (var i = place.thread; i < PIXELS; i += THREADS) {
        let v = exp((transform(load_x(sample * PIXELS + i, field)) - best) * SCALE);
        let at = position(i);
        sum += v;
        x += v * at.x;
        y += v * at.y;
    }
    sum = added(sum, place);
    x = added(x, place) / sum;
    y = added(y, place) / sum;
    if place.thread == 0u {
        kept[4u * group] = best;
        kept[4u * group + 1u] = sum;
        kept[4u * group + 2u] = x;
        kept[4u * group + 3u] = y;
        store_y_x(sample, field, transform(x * SIGNS_X));
        store_y_y(sample, field, transform(y * SIGNS_Y));
    }
}
