// Combines the values of a group of threads, in an order that does not depend on subgroups.

var<workgroup> shared_NAME: array<TYPE, THREADS>;

fn NAME(value: TYPE, thread: u32) -> TYPE {
    shared_NAME[thread] = value;
    workgroupBarrier();
    for (var step = THREADS / 2u; step > 0u; step /= 2u) {
        if thread < step {
            let a = shared_NAME[thread];
            let b = shared_NAME[thread + step];
            shared_NAME[thread] = COMBINED;
        }
        workgroupBarrier();
    }
    let result = shared_NAME[0];
    workgroupBarrier();
    return result;
}
