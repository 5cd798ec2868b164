
// Combines the values of a group of threads: those of each subgroup as the adapter does it, then
// those of the subgroups in their order.

var<workgroup> shared_NAME: array<TYPE, THREADS>;

fn NAME(value: TYPE, place: Place) -> TYPE {
    let own = OF_SUBGROUP(value);
    // the first thread of those that run, should a subgroup not be full
    if place.lane == subgroupMin(place.lane) {
        shared_NAME[place.subgroup] = own;
    }
    workgroupBarrier();
    var result = shared_NAME[0];
    for (var i = 1u; i < place.subgroups; i++) {
        let a = result;
        let b = shared_NAME[i];
        result = COMBINED;
    }
    workgroupBarrier();
    return result;
}
