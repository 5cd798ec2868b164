
// Combines the values of a group of threads.

var<workgroup> shared_NAME: array<TYPE, THREADS>;

fn NAME(value: TYPE, place: Place) -> TYPE {
    shared_NAME[place.thread] = value;
    workgroupBarrier();
    for (var step = THREADS / 2u; step > 0u; step /= 2u) {
        if place.thread < step {
            let a = shared_NAME[place.thread];
            let b = shared_NAME[place.thread + step];
            shared_NAME[place.thread] = COMBINED;
        }
        workgroupBarrier();
    }
    let result = shared_NAME[0];
    workgroupBarrier();
    return result;
}
