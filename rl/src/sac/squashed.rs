//! The tanh-Gaussian from which actions are drawn.
//!
//! Haarnoja et al., "Soft actor-critic" (arXiv 1801.01290, appendix C, "Enforcing action bounds"):
//! u is Gaussian and a = tanh(u), component by component. The network puts out 2 A numbers for each
//! observation: the means of u, and what becomes the logarithms of its standard deviations.
//! Everything is summed in f64, since log-probabilities are differences of large numbers.

use std::f64::consts::{LN_2, TAU};

/// Bounds of the logarithm of a standard deviation, those of CleanRL's soft actor-critic.
pub(super) const LOG_STD: [f64; 2] = [-5.0, 2.0];

/// The logarithm of a standard deviation for what the network puts out, and its slope.
pub(super) fn log_std(raw: f64) -> (f64, f64) {
    let half = (LOG_STD[1] - LOG_STD[0]) / 2.0;
    let squashed = raw.tanh();
    let log_std = LOG_STD[0] + half * (squashed + 1.0);
    (log_std, half * (1.0 - squashed * squashed))
}

/// What the network must put out for a logarithm of a standard deviation; none outside the bounds.
pub(super) fn raw_log_std(log_std: f64) -> Option<f64> {
    let share = (log_std - LOG_STD[0]) / (LOG_STD[1] - LOG_STD[0]);
    (share > 0.0 && share < 1.0).then(|| (2.0 * share - 1.0).atanh())
}

/// Writes the action for the `output` `[2 A]` of the network and standard normal `noise` `[A]`;
/// returns its log-probability density in nats (equation 21).
pub(super) fn sample(output: &[f64], noise: &[f32], action: &mut [f64]) -> f64 {
    let (means, raws) = output.split_at(action.len());
    let mut log_prob = 0.0;
    for (i, action) in action.iter_mut().enumerate() {
        let (log_std, noise) = (log_std(raws[i]).0, f64::from(noise[i]));
        let u = means[i] + log_std.exp() * noise;
        *action = u.tanh();
        log_prob -= 0.5 * noise * noise + log_std + 0.5 * TAU.ln() + log_slope(u);
    }
    log_prob
}

/// The logarithm of the derivative of tanh, ln(1 - tanh(u)^2), without its cancellation.
fn log_slope(u: f64) -> f64 {
    let negative = -2.0 * u.abs();
    2.0 * LN_2 + negative - 2.0 * negative.exp().ln_1p()
}

/// Writes the gradient of a loss in the `output` `[2 A]` from that in the action, `d_action` `[A]`,
/// and in its log-probability (equation 13).
pub(super) fn gradient(
    output: &[f64],
    noise: &[f32],
    (action, d_action): (&[f64], &[f64]),
    d_log_prob: f64,
    d_output: &mut [f64],
) {
    let width = action.len();
    for i in 0..width {
        let (log_std, slope) = log_std(output[width + i]);
        // d ln(1 - tanh(u)^2) / du = -2 tanh(u)
        let d_u = d_action[i] * (1.0 - action[i] * action[i]) + d_log_prob * 2.0 * action[i];
        d_output[i] = d_u;
        let d_log_std = d_u * log_std.exp() * f64::from(noise[i]) - d_log_prob;
        d_output[width + i] = d_log_std * slope;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OUTPUT: [f64; 4] = [0.3, -1.2, 0.5, -0.4];
    const NOISE: [f32; 2] = [0.7, -1.1];

    #[test]
    fn what_the_network_must_put_out_is_the_inverse() {
        for expected in [-4.9, -0.5, 1.9] {
            let raw = raw_log_std(expected).unwrap();
            assert!((log_std(raw).0 - expected).abs() < 1e-12);
        }
        assert!(raw_log_std(-5.0).is_none() && raw_log_std(f64::NAN).is_none());
    }

    /// The density of one component sums to 1 over (-1, 1), by the midpoint rule over noise.
    #[test]
    fn the_density_is_that_of_the_action() {
        let output = [0.4, 0.1];
        let steps: usize = 20_000;
        let at = |i: usize| -8.0 + 16.0 * i as f64 / steps as f64;
        let mut total = 0.0;
        for i in 0..steps {
            let [mut low, mut high, mut middle] = [[0.0]; 3];
            sample(&output, &[at(i) as f32], &mut low);
            sample(&output, &[at(i + 1) as f32], &mut high);
            let noise = (at(i) + 8.0 / steps as f64) as f32;
            let density = sample(&output, &[noise], &mut middle).exp();
            total += density * (high[0] - low[0]);
        }
        assert!((total - 1.0).abs() < 1e-3, "{total}");
    }

    #[test]
    fn far_means_have_finite_densities() {
        for mean in [-400.0, 400.0] {
            let mut action = [0.0];
            let log_prob = sample(&[mean, 0.0], &[0.5], &mut action);
            assert!(log_prob.is_finite() && action[0].abs() == 1.0);
        }
    }

    /// The loss w . a + c ln p.
    #[test]
    fn the_gradient_equals_finite_differences() {
        let (weights, c) = ([0.8, -0.6], 0.3);
        let loss = |output: &[f64]| {
            let mut action = [0.0; 2];
            let log_prob = sample(output, &NOISE, &mut action);
            weights[0] * action[0] + weights[1] * action[1] + c * log_prob
        };
        let (mut action, mut d_output) = ([0.0; 2], [0.0; 4]);
        sample(&OUTPUT, &NOISE, &mut action);
        gradient(&OUTPUT, &NOISE, (&action, &weights), c, &mut d_output);
        for (i, got) in d_output.into_iter().enumerate() {
            let [low, high] = [-1e-6, 1e-6].map(|h| {
                let mut moved = OUTPUT;
                moved[i] += h;
                loss(&moved)
            });
            let slope = (high - low) / 2e-6;
            assert!((got - slope).abs() < 1e-8, "{i}: {got} {slope}");
        }
    }
}
