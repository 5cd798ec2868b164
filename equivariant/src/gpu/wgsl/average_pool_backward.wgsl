// The gradient of the averages over windows.

fn run(pixel: u32, field: u32) {
    var sum = Field();
    for (var i = 0u; i < SIZE * SIZE; i++) {
        let row = window_at(pixel, vec2(i / SIZE, i % SIZE));
        if row >= 0 {
            sum += load_dy(u32(row), field) * SCALE;
        }
    }
    store_dx(pixel, field, sum);
}
