//! Settings of proximal policy optimisation.

use serde::{Deserialize, Serialize};

use crate::error::{
    RlError, require, require_count, require_log_std, require_positive, require_share,
    require_weight,
};
use crate::ppo::symmetry_loss::SymmetryLossSettings;

/// Settings of [`crate::Ppo`]. [`PpoSettings::tuned`] is the default.
///
/// In a file, a field that is missing has its default, and one that does not exist is an error.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PpoSettings {
    /// Discount factor gamma of the next decision's value, in [0, 1].
    pub gamma: f32,
    /// Decay factor lambda of generalised advantage estimation, in [0, 1].
    pub lambda: f32,
    /// Number of passes over the rollout in one update, at least 1.
    pub epochs: usize,
    /// Number of decisions in a minibatch, at least 2 (one decision has no advantage to normalise).
    pub minibatch: usize,
    /// Half-width of the interval around 1 to which the probability ratio is clipped, in (0, 1).
    pub clip: f32,
    /// Weight in the loss of the squared error of the value function, at least 0.
    pub value_weight: f32,
    /// Weight in the loss of the entropy bonus, at least 0.
    pub entropy_weight: f32,
    /// Maximum Euclidean norm of the gradient over all parameters, above 0; a longer gradient is
    /// scaled down to it.
    pub max_grad_norm: f32,
    /// Target KL divergence from the collecting policy, in nats, above 0; the update stops at 1.5
    /// times this value.
    pub max_kl: f32,
    /// Adam's step size for all parameters but those of the image encoder, above 0.
    pub head_learning_rate: f32,
    /// Adam's step size for the parameters of the image encoder, above 0.
    pub encoder_learning_rate: f32,
    /// Decrease of both learning rates during training; none by default.
    pub schedule: LearningRateSchedule,
    /// Adam's epsilon, the constant in the denominator of its step, above 0.
    pub adam_epsilon: f32,
    /// Minimum log_std, the logarithm of an action component's standard deviation, in [-10, 2]:
    /// smaller values are raised to it after each gradient step, so that exploration cannot vanish.
    /// [`Ppo::new`](crate::Ppo::new) rejects a policy that starts below.
    ///
    /// The default is from CleanRL's soft actor-critic (`LOG_STD_MIN = -5`): noise of 0.7 % of an
    /// action's unit. Training stays far above it; the published policies end between -1.4 and
    /// -0.4. Much below -10, actions in f32 are too coarse for their own density.
    pub min_log_std: f32,
    /// Additional loss for outputs of the policy that break a symmetry; none by default. Needs the
    /// CPU, and a second forward and backward pass for every decision.
    pub symmetry: Option<SymmetryLossSettings>,
}

/// Factor of the learning rates as a function of the gradient steps that the optimiser has taken.
/// An update keeps the factor that it begins with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum LearningRateSchedule {
    /// Factor of 1.
    #[default]
    Constant,
    /// Factor that falls linearly from 1 to 0.
    Linear {
        /// Number of gradient steps until the factor is 0, at least 1.
        steps: u64,
    },
    /// Factor that falls from 1 to 0 like half a period of a cosine (Loshchilov and Hutter, "SGDR",
    /// ICLR 2017, equation 5, without restarts).
    Cosine {
        /// Number of gradient steps until the factor is 0, at least 1.
        steps: u64,
    },
}

impl LearningRateSchedule {
    fn check(self) -> Result<(), RlError> {
        match self {
            Self::Constant => Ok(()),
            Self::Linear { steps } | Self::Cosine { steps } => {
                require_count("schedule.steps", steps as usize, 1, "at least 1")
            }
        }
    }

    /// Returns the factor in [0, 1] of the learning rates after `step` gradient steps.
    pub fn factor(self, step: u64) -> f32 {
        let left = |steps: u64| 1.0 - (step as f64 / steps as f64).min(1.0);
        let factor = match self {
            Self::Constant => 1.0,
            Self::Linear { steps } => left(steps),
            Self::Cosine { steps } => 0.5 - 0.5 * (std::f64::consts::PI * left(steps)).cos(),
        };
        factor as f32
    }
}

impl PpoSettings {
    /// Returns the hyper-parameters of COVERS (Liu et al., CoRL 2023, appendix). Value weight,
    /// gradient norm and epsilon, which the paper does not list, follow "The 37 implementation
    /// details of PPO" (Huang et al., ICLR blog track 2022).
    pub fn paper() -> Self {
        Self {
            gamma: 0.99,
            lambda: 0.95,
            epochs: 8,
            minibatch: 64,
            clip: 0.2,
            value_weight: 0.5,
            entropy_weight: 0.001,
            max_grad_norm: 0.5,
            max_kl: 0.05,
            head_learning_rate: 3e-4,
            encoder_learning_rate: 3e-4,
            schedule: LearningRateSchedule::Constant,
            adam_epsilon: 1e-5,
            min_log_std: -5.0,
            symmetry: None,
        }
    }

    /// Returns the paper's settings with the changes that made training faster here: learning rates
    /// of 1e-3 for the heads and 1e-4 for the encoder and a value weight of 0.1, from this
    /// project's feasibility study (docs/ppo.md); a discount of 0.95 and 12 epochs instead of 8,
    /// from the comparisons in docs/results/ppo_tuning.md.
    pub fn tuned() -> Self {
        Self {
            // rewards are dense and episodes last 50 decisions: a horizon of 1 / (1 - gamma) = 20
            // decisions is enough, and makes advantages less noisy
            gamma: 0.95,
            head_learning_rate: 1e-3,
            // a slow encoder keeps the KL divergence of an update below its limit
            encoder_learning_rate: 1e-4,
            // values sum many rewards, so at 0.5 their error takes up almost all of the clipped
            // gradient, and mean actions wander
            value_weight: 0.1,
            epochs: 12,
            ..Self::paper()
        }
    }

    /// Returns the KL divergence in nats above which an update stops, 1.5 * `max_kl`
    /// (Stable-Baselines3, `PPO.train`).
    pub fn kl_stop_threshold(&self) -> f64 {
        1.5 * f64::from(self.max_kl)
    }

    /// Checks that every setting of PPO is in its range.
    ///
    /// # Errors
    /// [`RlError::InvalidSetting`] names the field, its value and its range.
    pub fn check(&self) -> Result<(), RlError> {
        require_share("gamma", self.gamma)?;
        require_share("lambda", self.lambda)?;
        require_weight("value_weight", self.value_weight)?;
        require_weight("entropy_weight", self.entropy_weight)?;
        let clip_fits = self.clip > 0.0 && self.clip < 1.0;
        require("clip", self.clip, "a number in (0, 1)", clip_fits)?;
        require_positive("max_grad_norm", self.max_grad_norm)?;
        require_positive("max_kl", self.max_kl)?;
        require_positive("head_learning_rate", self.head_learning_rate)?;
        require_positive("encoder_learning_rate", self.encoder_learning_rate)?;
        require_positive("adam_epsilon", self.adam_epsilon)?;
        self.symmetry.map_or(Ok(()), |symmetry| symmetry.check())?;
        self.schedule.check()?;
        require_log_std("min_log_std", self.min_log_std)?;
        require_count("epochs", self.epochs, 1, "at least 1")?;
        require_count("minibatch", self.minibatch, 2, "at least 2")
    }

    /// Rejects a log_std below [`PpoSettings::min_log_std`], to which the first gradient step would
    /// raise it however small the gradient is.
    pub(super) fn check_min_log_std(&self, log_std: &[f32]) -> Result<(), RlError> {
        let min_log_std = self.min_log_std;
        match log_std.iter().find(|&&log_std| log_std < min_log_std) {
            Some(&log_std) => Err(RlError::LogStdBelowMinimum { log_std, min_log_std }),
            None => Ok(()),
        }
    }
}

impl Default for PpoSettings {
    fn default() -> Self {
        Self::tuned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schedules_fall_from_one_to_zero() {
        use LearningRateSchedule::{Constant, Cosine, Linear};
        let factors = |schedule: LearningRateSchedule| {
            [0, 25, 50, 100, 900].map(|step| schedule.factor(step))
        };
        assert_eq!(factors(Constant), [1.0; 5]);
        assert_eq!(factors(Linear { steps: 100 }), [1.0, 0.75, 0.5, 0.0, 0.0]);
        let cosine = factors(Cosine { steps: 100 });
        // half a period: cos(pi / 4) is the root of 1/2
        let expected = [1.0, 0.5 + 0.5 * 0.5f32.sqrt(), 0.5, 0.0, 0.0];
        assert!(cosine.iter().zip(expected).all(|(c, e)| (c - e).abs() < 1e-6), "{cosine:?}");
    }
}
