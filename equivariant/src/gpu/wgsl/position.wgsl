// The position of a pixel: x to the right, y upwards, the image's edges at -1 and 1.
fn position(pixel: u32) -> vec2<f32> {
    let x = f32(2u * (pixel % WIDTH) + 1u) - f32(WIDTH);
    let y = f32(2u * (pixel / WIDTH) + 1u) - f32(HEIGHT);
    return vec2(x / f32(WIDTH), -y / f32(HEIGHT));
}
