// Results of an update for the CPU: `log` begins with the state (RUNNING, or why no more steps are
// taken) and the clipping factor of the last gradient. One row for each minibatch follows.

const RUNNING = 0.0;
const STOPPED = 1.0;
const LOSS_NOT_FINITE = 2.0;
const NORM_NOT_FINITE = 3.0;

const ROW = 8u;

// Compilers may assume that floats are finite, so the bits are tested.
fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}
