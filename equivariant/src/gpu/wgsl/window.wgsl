// Positions of windows: inputs of an output pixel, and windows that contain an input pixel.

struct Orbit {
    // row and column of its first tap
    tap: vec2<u32>,
    // the first of its entries in a folded patch
    first: u32,
    // a bit for each parity that it has
    parities: u32,
    scale: f32,
}

struct Tap {
    first: u32,
    parities: u32,
    // the element that moves the first tap of the orbit here
    element: u32,
    scale: f32,
}

// The tap to which the group's element at this position moves another.
fn moved(tap: vec2<u32>, element: u32) -> vec2<u32> {
    let flips = element * FLIPS;
    let mirrored = vec2(SIZE - 1u) - tap;
    return select(tap, mirrored, vec2((flips & 2u) != 0u, (flips & 1u) != 0u));
}

// The index, in the batch, of the input pixel that a window of the batch sees at a tap; none in the
// padding.
fn pixel_at(row: u32, tap: vec2<u32>) -> i32 {
    let window = row % OUT_PIXELS;
    let y = i32(window / OUT_WIDTH * STRIDE + tap.x) - i32(PADDING);
    let x = i32(window % OUT_WIDTH * STRIDE + tap.y) - i32(PADDING);
    if y < 0 || x < 0 || y >= i32(HEIGHT) || x >= i32(WIDTH) {
        return -1;
    }
    return (i32(row / OUT_PIXELS) * i32(HEIGHT) + y) * i32(WIDTH) + x;
}

// The index, in the batch, of the window that sees an input pixel of the batch at a tap; none if no
// window does.
fn window_at(pixel: u32, tap: vec2<u32>) -> i32 {
    let place = pixel % (HEIGHT * WIDTH);
    let y = i32(place / WIDTH + PADDING) - i32(tap.x);
    let x = i32(place % WIDTH + PADDING) - i32(tap.y);
    let out = vec2(y, x) / i32(STRIDE);
    let inside = y >= 0 && x >= 0 && out.x < i32(OUT_PIXELS / OUT_WIDTH) && out.y < i32(OUT_WIDTH);
    if !inside || out.x * i32(STRIDE) != y || out.y * i32(STRIDE) != x {
        return -1;
    }
    let sample = i32(pixel / (HEIGHT * WIDTH));
    return sample * i32(OUT_PIXELS) + out.x * i32(OUT_WIDTH) + out.y;
}
