//! Action distributions: the diagonal Gaussian, the categorical, the tanh-Gaussian, and noise
//! correlated in time.
//!
//! Everything is summed in f64, since log-probabilities are subtracted from one another and
//! exponentiated.

use std::f64::consts::{LN_2, PI, TAU};

use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

use crate::env::{StepOutcome, choice_ranges};
use crate::error::{RlError, require};

/// Fills `out` with independent standard normal numbers: Box and Muller, "A note on the generation
/// of random normal deviates" (Annals of Mathematical Statistics 29, 1958). Unlike rejection
/// methods, it draws two uniform numbers for each pair, so the generator's position depends on the
/// length of `out` alone.
pub(crate) fn standard_normals(rng: &mut impl Rng, out: &mut [f32]) {
    for pair in out.chunks_mut(2) {
        let (u, v) = (rng.random::<f64>(), rng.random::<f64>());
        // 1 - u lies in (0, 1], so the logarithm is finite
        let radius = (-2.0 * (1.0 - u).ln()).sqrt();
        for (x, f) in pair.iter_mut().zip([f64::cos, f64::sin]) {
            *x = (radius * f(TAU * v)) as f32;
        }
    }
}

/// Returns the log-density of `action` under a diagonal Gaussian, ln N(action; mean,
/// exp(log_std)^2), summed over components.
pub(crate) fn log_prob(mean: &[f64], log_std: &[f64], action: &[f64]) -> f64 {
    let mut sum = 0.0;
    for ((m, s), a) in mean.iter().zip(log_std).zip(action) {
        sum -= 0.5 * ((a - m) * (-s).exp()).powi(2) + s + 0.5 * TAU.ln();
    }
    sum
}

/// Returns the differential entropy of a diagonal Gaussian in nats: log_std + ln(2 pi e) / 2,
/// summed over components.
pub(crate) fn entropy(log_std: &[f64]) -> f64 {
    log_std.iter().map(|s| s + 0.5 * ((2.0 * PI).ln() + 1.0)).sum()
}

/// Distribution of an action of A components: a diagonal Gaussian, or a categorical distribution of
/// each of several discrete actions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ActionDistribution<'a> {
    /// Means of the Gaussian, or logits of the choices, `[A]`.
    pub mean: &'a [f64],
    /// Logarithms of the Gaussian's standard deviations, `[A]`; of no meaning for choices.
    pub log_std: &'a [f64],
    /// Numbers of choices, see [`EnvSpec::choices`](crate::EnvSpec::choices).
    pub choices: &'a [usize],
}

impl ActionDistribution<'_> {
    /// Replaces the standard normal numbers in `noise` `[A]` by the action sampled with them.
    ///
    /// Choices are those with the largest sum of logit and Gumbel noise, which samples the
    /// categorical distribution (Gumbel, "Statistical theory of extreme values", 1954).
    pub fn sample(&self, noise: &mut [f32]) {
        if self.choices.is_empty() {
            for (i, number) in noise.iter_mut().enumerate() {
                *number = (self.mean[i] + self.log_std[i].exp() * f64::from(*number)) as f32;
            }
            return;
        }
        let scores = noise.iter().zip(self.mean).map(|(&e, logit)| logit + gumbel(e.into()));
        let scores: Vec<f64> = scores.collect();
        write_choices(&scores, self.choices, noise);
    }

    /// Writes the most likely action `[A]`.
    pub fn write_most_likely_action(&self, action: &mut [f32]) {
        if self.choices.is_empty() {
            action.iter_mut().zip(self.mean).for_each(|(a, &m)| *a = m as f32);
        } else {
            write_choices(self.mean, self.choices, action);
        }
    }

    /// Returns the logarithm of the density, or of the probability, of `action` `[A]`.
    pub fn log_prob(&self, action: &[f64]) -> f64 {
        if self.choices.is_empty() {
            return log_prob(self.mean, self.log_std, action);
        }
        let logs = choice_ranges(self.choices).flat_map(|part| log_softmax(&self.mean[part]));
        logs.zip(action).map(|(log, a)| a * log).sum()
    }

    /// Returns the entropy of the distribution in nats.
    pub fn entropy(&self) -> f64 {
        if self.choices.is_empty() {
            return entropy(self.log_std);
        }
        choice_ranges(self.choices).map(|part| choice_entropy(&log_softmax(&self.mean[part]))).sum()
    }

    /// Writes the gradient of a loss with respect to `mean` to `d_mean`, and adds that with respect
    /// to `log_std` to `d_log_std`, from its gradients with respect to the log-probability of
    /// `action` and to the entropy.
    pub fn backward(
        &self,
        action: &[f64],
        d_log_prob: f64,
        d_entropy: f64,
        d_mean: &mut [f64],
        d_log_std: &mut [f64],
    ) {
        if self.choices.is_empty() {
            for i in 0..d_mean.len() {
                let inverse = (-self.log_std[i]).exp();
                let z = (action[i] - self.mean[i]) * inverse;
                d_mean[i] = d_log_prob * z * inverse;
                d_log_std[i] += d_log_prob * (z * z - 1.0) + d_entropy;
            }
        }
        for part in choice_ranges(self.choices) {
            let logs = log_softmax(&self.mean[part.clone()]);
            let entropy = choice_entropy(&logs);
            for (i, log) in part.zip(logs) {
                let p = log.exp();
                d_mean[i] = d_log_prob * (action[i] - p) - d_entropy * p * (log + entropy);
            }
        }
    }
}

/// Writes the one-hot vectors of the choices with the largest scores; NaN for scores with NaN, which
/// callers find in the action.
fn write_choices(scores: &[f64], choices: &[usize], action: &mut [f32]) {
    action.fill(0.0);
    for part in choice_ranges(choices) {
        if scores[part.clone()].iter().any(|score| score.is_nan()) {
            action[part].fill(f32::NAN);
            continue;
        }
        let best = part.max_by(|&i, &j| scores[i].total_cmp(&scores[j]));
        best.into_iter().for_each(|i| action[i] = 1.0);
    }
}

/// Returns the logarithms of the probabilities that the logits of one discrete action give.
fn log_softmax(logits: &[f64]) -> Vec<f64> {
    let largest = logits.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let sum = logits.iter().map(|logit| (logit - largest).exp()).sum::<f64>();
    logits.iter().map(|logit| logit - largest - sum.ln()).collect()
}

/// Returns the entropy in nats of a choice whose probabilities have the logarithms `logs`.
fn choice_entropy(logs: &[f64]) -> f64 {
    -logs.iter().map(|log| log * log.exp()).sum::<f64>()
}

/// Maps a standard normal number to one of the standard Gumbel distribution, -ln(-ln(u)), with u
/// the normal cumulative probability.
fn gumbel(normal: f64) -> f64 {
    let tail = 0.5 * libm::erfc(normal.abs() / std::f64::consts::SQRT_2);
    // u is nearer to 1 than f64 can tell for large numbers
    let log_u = if normal < 0.0 { tail.ln() } else { (-tail).ln_1p() };
    -(-log_u).ln()
}

/// Bounds of log_std, the logarithm of the standard deviation of a tanh-Gaussian before the tanh:
/// `LOG_STD_MIN` and `LOG_STD_MAX` of CleanRL's `sac_continuous_action.py`.
pub(crate) const TANH_LOG_STD_BOUNDS: [f64; 2] = [-5.0, 2.0];

/// Maps the network's output `raw` to a log_std within [`TANH_LOG_STD_BOUNDS`]; returns log_std and
/// its derivative with respect to `raw`.
pub(crate) fn squash_log_std(raw: f64) -> (f64, f64) {
    let half = (TANH_LOG_STD_BOUNDS[1] - TANH_LOG_STD_BOUNDS[0]) / 2.0;
    let squashed = raw.tanh();
    let log_std = TANH_LOG_STD_BOUNDS[0] + half * (squashed + 1.0);
    (log_std, half * (1.0 - squashed * squashed))
}

/// Returns the network output that [`squash_log_std`] maps to `log_std`; `None` if `log_std` is not
/// strictly between its bounds.
pub(crate) fn unsquash_log_std(log_std: f64) -> Option<f64> {
    let share =
        (log_std - TANH_LOG_STD_BOUNDS[0]) / (TANH_LOG_STD_BOUNDS[1] - TANH_LOG_STD_BOUNDS[0]);
    (share > 0.0 && share < 1.0).then(|| (2.0 * share - 1.0).atanh())
}

/// Writes the tanh-Gaussian action `[A]` for the `output` `[2 A]` of the network and standard
/// normal `noise` `[A]`; returns the action's log-probability density in nats: Haarnoja et al.,
/// "Soft actor-critic" (arXiv 1801.01290, appendix C, "Enforcing action bounds", equation 21). u is
/// Gaussian and a = tanh(u), component by component; `output` holds the means of u, then the inputs
/// of [`squash_log_std`].
pub(crate) fn sample_tanh_gaussian(output: &[f64], noise: &[f32], action: &mut [f64]) -> f64 {
    let (means, raws) = output.split_at(action.len());
    let mut log_prob = 0.0;
    for (i, component) in action.iter_mut().enumerate() {
        let (log_std, noise) = (squash_log_std(raws[i]).0, f64::from(noise[i]));
        let u = means[i] + log_std.exp() * noise;
        *component = u.tanh();
        // the Gaussian density of u, whose normalised deviation is the noise, over d tanh(u) / du
        log_prob -= 0.5 * noise * noise + log_std + 0.5 * TAU.ln() + log_slope(u);
    }
    log_prob
}

/// Returns ln(1 - tanh(u)^2), the logarithm of the derivative of tanh.
fn log_slope(u: f64) -> f64 {
    // 1 - tanh(u)^2 = 4 e^(-2|u|) / (1 + e^(-2|u|))^2; the left side cancels to 0 for large |u|
    let negative = -2.0 * u.abs();
    2.0 * LN_2 + negative - 2.0 * negative.exp().ln_1p()
}

/// Writes the gradient of a loss with respect to the `output` `[2 A]` of the network from the
/// gradients with respect to the tanh-Gaussian action, `d_action` `[A]`, and to its log-probability
/// (arXiv 1801.01290, equation 13).
pub(crate) fn tanh_gaussian_gradient(
    output: &[f64],
    noise: &[f32],
    action: &[f64],
    d_action: &[f64],
    d_log_prob: f64,
    d_output: &mut [f64],
) {
    let width = action.len();
    for i in 0..width {
        let (log_std, slope) = squash_log_std(output[width + i]);
        // d ln(1 - tanh(u)^2) / du = -2 tanh(u)
        let d_u = d_action[i] * (1.0 - action[i] * action[i]) + d_log_prob * 2.0 * action[i];
        d_output[i] = d_u;
        // u = mean + std * noise, and ln pi contains -log_std
        let d_log_std = d_u * log_std.exp() * f64::from(noise[i]) - d_log_prob;
        d_output[width + i] = d_log_std * slope;
    }
}

/// Temporally correlated exploration noise `[N, A]` for N environments, independent in each
/// component and episode.
///
/// With independent standard normal e, x_0 = e_0 and x_t = c x_(t-1) + sqrt(1 - c^2) e_t. This
/// stationary autoregressive process of order one is standard normal at every step, and numbers k
/// steps apart have the correlation c^k (Korenkevych et al., "Autoregressive policies for
/// continuous control deep reinforcement learning", IJCAI 2019, p = 1).
#[derive(Clone, Debug)]
pub struct ActionNoise {
    /// Correlation c of the noise of consecutive steps, in [0, 1).
    correlation: f32,
    width: usize,
    values: Vec<f32>,
    new_values: Vec<f32>,
    /// `true` for each environment whose running episode has already been given noise, `[N]`.
    is_running: Vec<bool>,
}

impl ActionNoise {
    /// Creates noise for the actions of `envs` environments (N), of `width` components each (A, at
    /// least 1), independent from step to step.
    pub fn independent(envs: usize, width: usize) -> Self {
        Self {
            correlation: 0.0,
            width,
            values: vec![0.0; envs * width],
            new_values: vec![0.0; envs * width],
            is_running: vec![false; envs],
        }
    }

    /// Sets the correlation c of the noise of consecutive steps, in [0, 1).
    ///
    /// # Errors
    /// [`RlError::InvalidSetting`] for a correlation outside [0, 1).
    pub fn set_correlation(&mut self, correlation: f32) -> Result<(), RlError> {
        let allowed = (0.0..1.0).contains(&correlation);
        let expected = "a number in [0, 1)";
        require("noise_correlation", correlation, expected, allowed)?;
        self.correlation = correlation;
        Ok(())
    }

    /// Starts a new noise sequence in every environment, independent of the noise so far.
    pub fn restart_all(&mut self) {
        self.is_running.fill(false);
    }

    /// Starts a new noise sequence, independent of the noise so far, in every environment whose
    /// episode has ended by `outcomes`, `[N]`.
    pub fn restart_ended(&mut self, outcomes: &[StepOutcome]) {
        for (is_running, outcome) in self.is_running.iter_mut().zip(outcomes) {
            *is_running &= !outcome.is_ended();
        }
    }

    /// Samples the noise `[N, A]` of the next step of all environments: standard normal numbers.
    pub fn sample(&mut self, rng: &mut ChaCha8Rng) -> &[f32] {
        standard_normals(rng, &mut self.new_values);
        // weights whose squares add up to 1 keep the variance at 1
        let (kept, new) = (self.correlation, (1.0 - self.correlation.powi(2)).sqrt());
        let rows = self.values.chunks_exact_mut(self.width);
        let new_values = self.new_values.chunks_exact(self.width);
        for ((row, drawn), begun) in rows.zip(new_values).zip(&mut self.is_running) {
            if std::mem::replace(begun, true) {
                row.iter_mut().zip(drawn).for_each(|(x, e)| *x = kept * *x + new * e);
            } else {
                row.copy_from_slice(drawn);
            }
        }
        &self.values
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::fixtures::central_difference;

    #[test]
    fn normals_have_unit_moments() {
        let mut x = vec![0.0; 20_001];
        standard_normals(&mut ChaCha8Rng::seed_from_u64(1), &mut x);
        let moment = |k| x.iter().map(|&v| f64::from(v).powi(k)).sum::<f64>() / x.len() as f64;
        // standard errors: 0.007, 0.010, 0.027, 0.069
        assert!(moment(1).abs() < 0.03 && (moment(2) - 1.0).abs() < 0.04);
        assert!(moment(3).abs() < 0.1 && (moment(4) - 3.0).abs() < 0.3);
    }

    /// Density of N(1, 4) at 2: exp(-1/8) / (2 sqrt(2 pi)) = 0.176032663...
    #[test]
    fn log_prob_by_hand() {
        let p = log_prob(&[1.0], &[2f64.ln()], &[2.0]).exp();
        assert!((p - 0.176_032_663_382_149_74).abs() < 1e-12, "{p}");
        let two = log_prob(&[1.0, 1.0], &[2f64.ln(); 2], &[2.0, 2.0]).exp();
        assert!((two - p * p).abs() < 1e-12);
    }

    /// The entropy is the expectation of -ln p, here by the midpoint rule.
    #[test]
    fn entropy_is_the_expected_surprise() {
        let (mean, log_std, dx) = ([0.3], [-0.5], 1e-3);
        let surprise: f64 = (-8000..8000)
            .map(|i| log_prob(&mean, &log_std, &[(f64::from(i) + 0.5) * dx]))
            .map(|lp| -lp * lp.exp() * dx)
            .sum();
        assert!((surprise - entropy(&log_std)).abs() < 1e-6);
    }

    const CHOICES: ActionDistribution =
        ActionDistribution { mean: &[0.3, -1.2, 0.5, 2.0, -0.4], log_std: &[], choices: &[3, 2] };

    #[test]
    fn choices_are_drawn_as_often_as_their_probabilities_say() {
        let (mut rng, mut counts) = (ChaCha8Rng::seed_from_u64(4), [0.0; 5]);
        for _ in 0..20_000 {
            let mut action = [0.0; 5];
            standard_normals(&mut rng, &mut action);
            CHOICES.sample(&mut action);
            counts.iter_mut().zip(action).for_each(|(count, a)| *count += f64::from(a) / 20_000.0);
        }
        for (i, found) in counts.into_iter().enumerate() {
            let part = if i < 3 { 0..3 } else { 3..5 };
            let total: f64 = CHOICES.mean[part].iter().map(|logit| logit.exp()).sum();
            let expected = CHOICES.mean[i].exp() / total;
            // three standard errors
            assert!((found - expected).abs() < 0.011, "{i}: {found} {expected}");
        }
        let mut mode = [0.5; 5];
        CHOICES.write_most_likely_action(&mut mode);
        assert_eq!(mode, [0.0, 0.0, 1.0, 1.0, 0.0]);
        assert!([-9.0, 9.0].map(gumbel).iter().all(|noise| noise.is_finite()));
    }

    /// The loss 0.7 ln p + 0.3 H of an action.
    #[test]
    fn the_gradient_of_choices_equals_finite_differences() {
        let action = [0.0, 1.0, 0.0, 1.0, 0.0];
        let loss = |mean: &[f64]| {
            let distribution = ActionDistribution { mean, ..CHOICES };
            0.7 * distribution.log_prob(&action) + 0.3 * distribution.entropy()
        };
        let mut d_mean = [0.0; 5];
        CHOICES.backward(&action, 0.7, 0.3, &mut d_mean, &mut []);
        for (i, got) in d_mean.into_iter().enumerate() {
            let slope = central_difference(&mut CHOICES.mean.to_vec(), i, 1e-6, loss);
            assert!((got - slope).abs() < 1e-8, "{i}: {got} {slope}");
        }
    }

    const OUTPUT: [f64; 4] = [0.3, -1.2, 0.5, -0.4];
    const NOISE: [f32; 2] = [0.7, -1.1];

    #[test]
    fn what_the_network_must_put_out_is_the_inverse() {
        for expected in [-4.9, -0.5, 1.9] {
            let raw = unsquash_log_std(expected).unwrap();
            assert!((squash_log_std(raw).0 - expected).abs() < 1e-12);
        }
        assert!(unsquash_log_std(-5.0).is_none() && unsquash_log_std(f64::NAN).is_none());
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
            sample_tanh_gaussian(&output, &[at(i) as f32], &mut low);
            sample_tanh_gaussian(&output, &[at(i + 1) as f32], &mut high);
            let noise = (at(i) + 8.0 / steps as f64) as f32;
            let density = sample_tanh_gaussian(&output, &[noise], &mut middle).exp();
            total += density * (high[0] - low[0]);
        }
        assert!((total - 1.0).abs() < 1e-3, "{total}");
    }

    #[test]
    fn far_means_have_finite_densities() {
        for mean in [-400.0, 400.0] {
            let mut action = [0.0];
            let log_prob = sample_tanh_gaussian(&[mean, 0.0], &[0.5], &mut action);
            assert!(log_prob.is_finite() && action[0].abs() == 1.0);
        }
    }

    /// The loss w . a + c ln p.
    #[test]
    fn the_gradient_equals_finite_differences() {
        let (weights, c) = ([0.8, -0.6], 0.3);
        let loss = |output: &[f64]| {
            let mut action = [0.0; 2];
            let log_prob = sample_tanh_gaussian(output, &NOISE, &mut action);
            weights[0] * action[0] + weights[1] * action[1] + c * log_prob
        };
        let (mut action, mut d_output) = ([0.0; 2], [0.0; 4]);
        sample_tanh_gaussian(&OUTPUT, &NOISE, &mut action);
        tanh_gaussian_gradient(&OUTPUT, &NOISE, &action, &weights, c, &mut d_output);
        for (i, got) in d_output.into_iter().enumerate() {
            let slope = central_difference(&mut OUTPUT.clone(), i, 1e-6, loss);
            assert!((got - slope).abs() < 1e-8, "{i}: {got} {slope}");
        }
    }

    /// The recursion with a correlation is tested with the collection of rollouts.
    #[test]
    fn without_correlation_it_is_what_the_generator_says() {
        let mut noise = ActionNoise::independent(50, 2);
        let [mut rng, mut own] = [7, 7].map(ChaCha8Rng::seed_from_u64);
        for _ in 0..3 {
            let mut plain = [0.0; 100];
            standard_normals(&mut own, &mut plain);
            assert_eq!(noise.sample(&mut rng), plain);
        }
    }

    #[test]
    fn a_correlation_that_keeps_everything_is_refused() {
        let mut noise = ActionNoise::independent(1, 1);
        for wrong in [-0.1, 1.0, f32::NAN] {
            let message = noise.set_correlation(wrong).unwrap_err().to_string();
            assert!(message.contains("noise_correlation") && message.contains("[0, 1)"));
        }
    }
}
