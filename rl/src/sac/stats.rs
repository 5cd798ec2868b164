//! Statistics of an update of soft actor-critic.

use crate::algorithm::{Metrics, named, sums};

/// Statistics of one update of soft actor-critic: means over all steps of all minibatches. If there
/// were none, as during the burn-in, `steps` is 0 and the means are zeros without a meaning, so
/// that every row of a log has the same columns, and numbers in all of them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SacStats {
    /// Halved squared error of the Q-values, summed over both critics.
    pub critic_loss: f64,
    /// Loss of the actor, without behavioural cloning.
    pub actor_loss: f64,
    /// Squared distance of the actor's mean action from the action in the replay buffer, summed
    /// over components.
    pub cloning_loss: f64,
    /// Mean Q-value of the actions in the replay buffer, over both critics.
    pub value: f64,
    /// Estimated entropy of actions in nats.
    pub entropy: f64,
    /// Temperature alpha, the weight of the entropy, after the update.
    pub temperature: f64,
    /// Euclidean norm of the gradient before clipping, mean over gradient steps.
    pub grad_norm: f64,
    /// Share in [0, 1] of the gradient's components that were clipped.
    pub clip_fraction: f64,
    /// Number of gradient steps taken in the update.
    pub steps: usize,
    /// Number of steps that the replay buffer holds.
    pub replay: usize,
}

impl Metrics for SacStats {
    /// Returns the statistics in the order of the struct's fields.
    fn metrics(&self) -> Vec<(String, f64)> {
        named!(
            self: critic_loss, actor_loss, cloning_loss, value, entropy, temperature, grad_norm,
            clip_fraction, steps, replay
        )
    }
}

sums! {
    /// Sums over steps of the terms of SAC's losses and of the diagnostics.
    SacSums: samples, critic_loss, actor_loss, cloning_loss, value, log_pi
}

/// Running sums of an update of soft actor-critic: losses, gradient norms and gradient steps.
#[derive(Default)]
pub(crate) struct SacTotals {
    pub sums: SacSums,
    pub grad_norm_sum: f64,
    pub clipped: f64,
    pub steps: usize,
}

impl SacTotals {
    pub fn stats(&self, temperature: f64, replay: usize) -> SacStats {
        let mean = |sum: f64| sum / self.sums.samples.max(1.0);
        let each = |sum: f64| sum / self.steps.max(1) as f64;
        SacStats {
            critic_loss: mean(self.sums.critic_loss),
            actor_loss: mean(self.sums.actor_loss),
            cloning_loss: mean(self.sums.cloning_loss),
            value: mean(self.sums.value),
            entropy: mean(-self.sums.log_pi),
            temperature,
            grad_norm: each(self.grad_norm_sum),
            clip_fraction: each(self.clipped),
            steps: self.steps,
            replay,
        }
    }
}
