// What an update leaves for the processor: `log` begins with the state, RUNNING or why no step is
// taken any more, and the factor of the last gradient. A row for each minibatch follows.

const RUNNING = 0.0;
const STOPPED = 1.0;
const LOSS_NOT_FINITE = 2.0;
const NORM_NOT_FINITE = 3.0;

const ROW = 8u;

// Compilers may take it for granted that numbers are finite, but not of bits.
fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}
