// An observation of a batch; in an update, the decision and its normalised advantage.
struct Draw {
    decision: u32,
    advantage: f32,
}
