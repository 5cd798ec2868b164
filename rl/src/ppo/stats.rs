//! Statistics of an update of proximal policy optimisation.

use crate::algorithm::{Metrics, named, sums};

/// Weights of the terms of the PPO loss, and the clip interval of its surrogate.
#[derive(Clone, Copy, Debug)]
pub(super) struct LossWeights {
    /// Half-width of the interval around 1 to which the probability ratio is clipped.
    pub clip_coef: f64,
    /// Weight in the loss of the squared error of the value function.
    pub vf_coef: f64,
    /// Weight in the loss of the entropy bonus.
    pub ent_coef: f64,
    /// Weight of the symmetry loss in the total loss.
    pub symmetry: f64,
}

/// Statistics of one PPO update. Losses and diagnostics are means over all decisions of all
/// minibatches that were run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PpoStats {
    /// Actor loss: the negated clipped surrogate objective of PPO.
    pub policy_loss: f64,
    /// Squared error of the value function against the returns, without its weight.
    pub value_loss: f64,
    /// Entropy of the action distribution in nats.
    pub entropy: f64,
    /// Estimated KL divergence of the new policy from the collecting one, in nats, at least 0.
    pub approx_kl: f64,
    /// Share in [0, 1] of decisions whose probability ratio left the clip interval.
    pub clip_fraction: f64,
    /// Explained variance 1 - Var(return - value) / Var(return) before the update: 1 for a perfect
    /// critic, 0 for a constant one.
    pub explained_variance: f64,
    /// Euclidean norm of the gradient before clipping, mean over gradient steps.
    pub grad_norm: f64,
    /// Number of gradient steps taken in the update.
    pub steps: usize,
    /// Number of complete passes over the rollout; fewer than set when the KL divergence stopped
    /// the update.
    pub epochs: usize,
    /// Logarithm of every action component's standard deviation after the update, `[A]`.
    pub log_std: Vec<f32>,
    /// Unweighted symmetry loss; `None` without a
    /// [`SymmetryLossSettings`](crate::SymmetryLossSettings).
    pub symmetry_loss: Option<f64>,
}

impl Metrics for PpoStats {
    /// Returns the statistics in the order of the struct's fields. The components of `log_std` are
    /// `log_std_0`, `log_std_1`, ...; `symmetry_loss` comes last, if there is one.
    fn metrics(&self) -> Vec<(String, f64)> {
        let mut all = named!(
            self: policy_loss, value_loss, entropy, approx_kl, clip_fraction, explained_variance,
            grad_norm, steps, epochs
        );
        let components = self.log_std.iter().enumerate();
        all.extend(components.map(|(i, &s)| (format!("log_std_{i}"), f64::from(s))));
        all.extend(self.symmetry_loss.map(|loss| ("symmetry_loss".to_owned(), loss)));
        all
    }
}

sums! {
    /// Sums over decisions of the terms of the PPO loss and of the diagnostics.
    LossSums: samples, policy_loss, value_loss, entropy, approx_kl, clip_fraction, symmetry_loss
}

/// Running sums of a PPO update: losses, gradient norms, gradient steps and epochs.
#[derive(Default)]
pub(crate) struct PpoTotals {
    pub losses: LossSums,
    pub grad_norm_sum: f64,
    pub steps: usize,
    pub epochs: usize,
}

impl PpoTotals {
    /// Returns the statistics of the update; `values` and `returns` `[T, N]` are from before the
    /// update.
    pub fn stats(&self, values: &[f32], returns: &[f32], log_std: &[f32]) -> PpoStats {
        let mean = |sum: f64| sum / self.losses.samples;
        PpoStats {
            policy_loss: mean(self.losses.policy_loss),
            value_loss: mean(self.losses.value_loss),
            entropy: mean(self.losses.entropy),
            approx_kl: mean(self.losses.approx_kl),
            clip_fraction: mean(self.losses.clip_fraction),
            explained_variance: explained_variance(values, returns),
            // there is no step if the first minibatch already stops the update
            grad_norm: self.grad_norm_sum / self.steps.max(1) as f64,
            steps: self.steps,
            epochs: self.epochs,
            log_std: log_std.to_vec(),
            symmetry_loss: None,
        }
    }
}

/// Returns the critic's explained variance, 1 - Var(return - value) / Var(return); 0 if the returns
/// do not vary.
fn explained_variance(values: &[f32], returns: &[f32]) -> f64 {
    let total = variance(returns.iter().map(|&r| f64::from(r)));
    let residual = variance(returns.iter().zip(values).map(|(&r, &v)| f64::from(r) - f64::from(v)));
    if total > 0.0 { 1.0 - residual / total } else { 0.0 }
}

fn variance(numbers: impl ExactSizeIterator<Item = f64> + Clone) -> f64 {
    let count = numbers.len() as f64;
    let mean = numbers.clone().sum::<f64>() / count;
    numbers.map(|x| (x - mean).powi(2)).sum::<f64>() / count
}
