// Index of an observation of a batch; in an update, also its decision's normalised advantage.
struct Sample {
    decision: u32,
    advantage: f32,
}
