// The sum over taps of what `term` makes of what is there: of the pixels that a window sees, or of
// the windows that see a pixel. `at_tap` finds them.

fn run(place: u32, field: u32) {
    var sum = Term();
    for (var i = 0u; i < SIZE * SIZE; i++) {
        let found = at_tap(place, vec2(i / SIZE, i % SIZE));
        if found >= 0 {
            sum += term(place, i, u32(found), field);
        }
    }
    store_sum(place, field, sum);
}
