// Sums over a group of threads, in an order that does not depend on subgroups.

var<workgroup> shared_sums: array<f32, THREADS>;

fn summed(value: f32, thread: u32) -> f32 {
    shared_sums[thread] = value;
    workgroupBarrier();
    for (var step = THREADS / 2u; step > 0u; step /= 2u) {
        if thread < step {
            shared_sums[thread] += shared_sums[thread + step];
        }
        workgroupBarrier();
    }
    let sum = shared_sums[0];
    workgroupBarrier();
    return sum;
}
