
// Sums the values of a group of threads: those of each subgroup as the adapter does it, then
// those of the subgroups in their order.

var<workgroup> shared_values: array<f32, THREADS>;

fn summed(value: f32, place: Place) -> f32 {
    let own = subgroupAdd(value);
    // the first thread of those that run, should a subgroup not be full
    if place.lane == subgroupMin(place.lane) {
        shared_values[place.subgroup] = own;
    }
    workgroupBarrier();
    var result = shared_values[0];
    for (var i = 1u; i < place.subgroups; i++) {
        let a = result;
        let b = shared_values[i];
        result = a + b;
    }
    workgroupBarrier();
    return result;
}
