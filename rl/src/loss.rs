//! The loss of proximal policy optimisation for one decision, and its gradient with respect to what
//! the network put out.

use crate::figures::sums;
use crate::gaussian::{entropy, log_prob};

/// Where the logarithm of a ratio is cut, so that sums over a minibatch stay finite in single
/// precision. One decision beyond it brings the KL estimate past every limit, which ends an update
/// before it learns from that.
pub(crate) const LARGEST_LOG_RATIO: f64 = 60.0;

/// Weights of the terms of the loss.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LossWeights {
    /// Half-width of the ratio's clip interval.
    pub clip: f64,
    /// Weight of the squared value error.
    pub value: f64,
    /// Weight of the entropy bonus.
    pub entropy: f64,
    /// Weight of the loss of broken symmetries.
    pub symmetry: f64,
}

/// What was recorded about a decision.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample<'a> {
    /// The action taken, `[A]`.
    pub action: &'a [f64],
    /// Its log-probability when it was taken.
    pub log_prob: f64,
    /// Its normalised advantage.
    pub advantage: f64,
    /// Target of the value function.
    pub target: f64,
}

/// What the network says about the decision now, or the gradient with respect to that.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Output<'a> {
    /// Mean action, `[A]`.
    pub mean: &'a [f64],
    /// Logarithms of the standard deviations, `[A]`.
    pub log_std: &'a [f64],
    /// V(s).
    pub value: f64,
}

sums! {
    /// Sums over decisions of the loss's terms and of the diagnostics.
    LossSums: samples, policy, value, entropy, kl, clipped, symmetry
}

/// Loss terms of one decision. Writes the gradient with respect to the mean to `d_mean`, adds the
/// one with respect to log_std to `d_log_std`, and returns the one with respect to the value; all
/// are multiplied by `scale` (1 / batch).
///
/// Schulman et al., "Proximal policy optimization algorithms" (arXiv 1707.06347), equations 7 and
/// 9, without value clipping. The KL estimator is k3 of Schulman, "Approximating KL divergence"
/// (2020): (r - 1) - ln r.
pub(crate) fn sample_loss(
    weights: &LossWeights,
    sample: &Sample,
    output: &Output,
    scale: f64,
    d_mean: &mut [f64],
    d_log_std: &mut [f64],
) -> (LossSums, f64) {
    let log_ratio = log_prob(output.mean, output.log_std, sample.action) - sample.log_prob;
    let ratio = match log_ratio > LARGEST_LOG_RATIO {
        true => LARGEST_LOG_RATIO.exp(),
        false => log_ratio.exp(),
    };
    let surrogate = ratio * sample.advantage;
    let clipped = ratio.clamp(1.0 - weights.clip, 1.0 + weights.clip) * sample.advantage;
    // where the minimum takes the clipped branch, the loss does not depend on the policy
    let d_log_prob = if surrogate <= clipped {
        -surrogate * scale
    } else {
        0.0
    };
    for i in 0..d_mean.len() {
        let inverse = (-output.log_std[i]).exp();
        let z = (sample.action[i] - output.mean[i]) * inverse;
        d_mean[i] = d_log_prob * z * inverse;
        d_log_std[i] += d_log_prob * (z * z - 1.0) - weights.entropy * scale;
    }
    let error = output.value - sample.target;
    let sums = LossSums {
        samples: 1.0,
        policy: -surrogate.min(clipped),
        value: error * error,
        entropy: entropy(output.log_std),
        kl: (ratio - 1.0) - log_ratio,
        clipped: f64::from(u8::from((ratio - 1.0).abs() > weights.clip)),
        symmetry: 0.0,
    };
    (sums, 2.0 * weights.value * error * scale)
}

#[cfg(test)]
impl LossSums {
    /// The sum that is minimised.
    pub fn total(&self, weights: &LossWeights) -> f64 {
        self.policy + weights.value * self.value - weights.entropy * self.entropy
            + weights.symmetry * self.symmetry
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WEIGHTS: LossWeights = LossWeights {
        clip: 0.2,
        value: 0.5,
        entropy: 0.01,
        symmetry: 0.0,
    };

    /// What is minimised, and its gradient; parameters are mean (2), log_std (2), value.
    fn loss(p: &[f64; 5], sample: &Sample) -> (f64, [f64; 5]) {
        let output = Output {
            mean: &p[..2],
            log_std: &p[2..4],
            value: p[4],
        };
        let (mut mean, mut log_std) = ([0.0; 2], [0.0; 2]);
        let (sums, value) = sample_loss(&WEIGHTS, sample, &output, 1.0, &mut mean, &mut log_std);
        let gradient = [mean[0], mean[1], log_std[0], log_std[1], value];
        (sums.total(&WEIGHTS), gradient)
    }

    #[test]
    fn gradient_equals_finite_differences_on_every_branch() {
        let p = [0.3, -0.2, -0.5, 0.1, 1.5];
        let action = [0.6, 0.4];
        let now = log_prob(&p[..2], &p[2..4], &action);
        // ratios inside, above and below the clip interval, with both signs of the advantage
        for shift in [0.05, 1.0, -1.0] {
            for advantage in [0.7, -1.3] {
                let sample = Sample {
                    action: &action,
                    log_prob: now - shift,
                    advantage,
                    target: 0.4,
                };
                for (i, g) in loss(&p, &sample).1.into_iter().enumerate() {
                    let at = |h: f64| {
                        let mut moved = p;
                        moved[i] += h;
                        loss(&moved, &sample).0
                    };
                    let slope = (at(1e-5) - at(-1e-5)) / 2e-5;
                    assert!(
                        (slope - g).abs() < 1e-8,
                        "{shift} {advantage} {i}: {g} {slope}"
                    );
                }
            }
        }
    }

    #[test]
    fn an_improvement_beyond_the_clip_has_no_gradient() {
        let p = [0.3, -0.2, -0.5, 0.1, 1.5];
        let action = [0.6, 0.4];
        let now = log_prob(&p[..2], &p[2..4], &action);
        let sample = Sample {
            action: &action,
            log_prob: now - 1.0,
            advantage: 1.0,
            target: 0.0,
        };
        assert_eq!(loss(&p, &sample).1[..2], [0.0, 0.0]);
        let worse = Sample {
            advantage: -1.0,
            ..sample
        };
        assert_ne!(loss(&p, &worse).1[0], 0.0);
    }

    /// An action far from a narrow policy's mean, as mirrored ones are of a network without the
    /// symmetry: a small step of the mean multiplies its probability beyond any number.
    #[test]
    fn a_ratio_beyond_all_numbers_ends_an_update_and_one_that_is_none_is_an_error() {
        let losses = |log_prob: f64| {
            let sample = Sample {
                action: &[0.0; 2],
                log_prob,
                advantage: -3.0,
                target: 0.0,
            };
            let output = Output {
                mean: &[0.0; 2],
                log_std: &[0.0; 2],
                value: 0.0,
            };
            let (mut d_mean, mut d_log_std) = ([0.0; 2], [0.0; 2]);
            sample_loss(&WEIGHTS, &sample, &output, 1.0, &mut d_mean, &mut d_log_std).0
        };
        let far = losses(-1e4);
        assert!(far.policy.is_finite() && (250.0 * far.policy.abs()) < f64::from(f32::MAX));
        assert!((far.kl as f32).is_finite() && far.kl / 1e6 > 1e6);
        assert!(losses(f64::NAN).policy.is_nan() && losses(f64::NAN).kl.is_nan());
    }

    /// By hand: the ratio is e^0.5, so k3 is e^0.5 - 1 - 0.5.
    #[test]
    fn diagnostics_by_hand() {
        let (p, action) = ([0.0; 2], [0.0; 2]);
        let now = log_prob(&p, &p, &action);
        let sample = Sample {
            action: &action,
            log_prob: now - 0.5,
            advantage: 2.0,
            target: 1.0,
        };
        let output = Output {
            mean: &p,
            log_std: &p,
            value: 3.0,
        };
        let (sums, d_value) = sample_loss(
            &WEIGHTS,
            &sample,
            &output,
            0.25,
            &mut [0.0; 2],
            &mut [0.0; 2],
        );
        assert!((sums.kl - (0.5f64.exp() - 1.5)).abs() < 1e-12);
        assert!((sums.policy + 2.0 * 1.2).abs() < 1e-12);
        assert_eq!((sums.value, sums.clipped, d_value), (4.0, 1.0, 0.5));
    }
}
