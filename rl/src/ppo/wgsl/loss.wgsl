// The loss of a minibatch and its gradient with respect to the network's outputs, as in `ppo.rs`.
// `decisions` holds the action, its log-probability and the return of each decision. One group.

const HALF_LN_TAU = 0.9189385;

@compute @workgroup_size(THREADS)
fn main(place: Place) {
    let thread = place.thread;
    let scale = 1.0 / f32(batch.samples);
    // policy, value, kl, clipped
    var terms = vec4<f32>();
    var d_log_std: array<f32, ACTION>;
    for (var s = thread; s < batch.samples; s += THREADS) {
        let sample = samples[batch.start + s];
        let at = sample.decision * (ACTION + 2u);
        var log_ratio = -decisions[at + ACTION];
        for (var j = 0u; j < ACTION; j++) {
            let log_std = params[LOG_STD + component[j]];
            let z = (decisions[at + j] - mean[s * ACTION + j]) * exp(-log_std);
            log_ratio -= 0.5 * z * z + log_std + HALF_LN_TAU;
        }
        let ratio = exp(select(log_ratio, MAX_LOG_RATIO, log_ratio > MAX_LOG_RATIO));
        let surrogate = ratio * sample.advantage;
        let clipped = clamp(ratio, 1.0 - CLIP, 1.0 + CLIP) * sample.advantage;
        // where the minimum takes the clipped branch, the loss does not depend on the policy
        let d_log_prob = select(0.0, -surrogate * scale, surrogate <= clipped);
        for (var j = 0u; j < ACTION; j++) {
            let inverse = exp(-params[LOG_STD + component[j]]);
            let z = (decisions[at + j] - mean[s * ACTION + j]) * inverse;
            d_mean[s * ACTION + j] = d_log_prob * z * inverse;
            d_log_std[j] += d_log_prob * (z * z - 1.0) - ENTROPY * scale;
        }
        let error = value[s] - decisions[at + ACTION + 1u];
        d_value[s] = 2.0 * VALUE * error * scale;
        let outside = select(0.0, 1.0, abs(ratio - 1.0) > CLIP);
        let kl = (ratio - 1.0) - log_ratio;
        terms += vec4(-min(surrogate, clipped), error * error, kl, outside);
    }
    let sums = vec4(
        summed(terms.x, place),
        summed(terms.y, place),
        summed(terms.z, place),
        summed(terms.w, place),
    );
    var entropy = 0.0;
    for (var j = 0u; j < ACTION; j++) {
        let total = summed(d_log_std[j], place);
        entropy += params[LOG_STD + component[j]] + HALF_LN_TAU + 0.5;
        if thread == 0u {
            gradient[LOG_STD + component[j]] = total;
        }
    }
    if thread == 0u && log[0] == RUNNING {
        let row = ROW * (batch.index + 1u);
        log[row] = f32(batch.samples);
        log[row + 1u] = sums.x;
        log[row + 2u] = sums.y;
        log[row + 3u] = f32(batch.samples) * entropy;
        log[row + 4u] = sums.z;
        log[row + 5u] = sums.w;
        if !is_finite(sums.x + sums.y + sums.z) {
            log[0] = LOSS_NOT_FINITE;
        } else if sums.z > KL_STOP * f32(batch.samples) {
            log[0] = STOPPED;
        }
    }
}
