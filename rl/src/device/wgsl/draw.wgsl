// A decision of a minibatch, and its normalised advantage.
struct Draw {
    decision: u32,
    advantage: f32,
}
