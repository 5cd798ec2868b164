// The mean and one over the standard deviation that were given for a field.
fn standard_of(part: u32, field: u32, place: Place) -> vec2<f32> {
    return standards[field];
}
