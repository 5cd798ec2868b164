//! Settings of soft actor-critic.

use serde::{Deserialize, Serialize};
use symmetry::Group;

use crate::error::{RlError, require, require_positive, require_share, require_weight};
use crate::ppo::settings::PpoSettings;

/// The largest minibatch.
const MAX_BATCH: usize = 1 << 16;
/// The most gradient steps for one recorded step.
const MAX_UPDATES_PER_STEP: f32 = 1000.0;

/// Settings of [`crate::Sac`]. [`SacSettings::paper`] is the default.
///
/// In a file, a field that is missing has its default, and one that does not exist is an error.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SacSettings {
    /// Discount of the next decision's value, in [0, 1].
    pub gamma: f32,
    /// Steps in a minibatch, 1 to 65536.
    pub batch: usize,
    /// Steps of a minibatch that follow one another in an episode, a divisor of `batch`. The first
    /// of them is drawn; after an episode's last held step comes its first, so that every step is
    /// drawn equally often. Where [`Replay::mark`](crate::Replay::mark) stands within an episode,
    /// windows of its newest steps reach back before the mark. Steps of a window share
    /// observations, each of which is encoded once: a window of w steps takes w + 1 observations,
    /// and w + 1 + L with a context of L steps, where single steps take 2 w and (2 + L) w.
    pub window: usize,
    /// Gradient steps for each recorded step, at least 0; below 1, several recorded steps share a
    /// gradient step. All steps that a replay ever recorded count ([`Sac::due`](crate::Sac::due)).
    ///
    /// By default, a step that is recorded after the burn-in is passed through as many gradient
    /// steps as PPO's default passes it through at most, 12 on average
    /// ([`SacSettings::with_update_ratio_of`]): 12 / 512 gradient steps. The burn-in's are not made up for,
    /// and PPO may stop early by its KL divergence.
    pub updates_per_step: f32,
    /// ReplayStep steps before the first gradient step.
    pub burn_in: u64,
    /// Adam's step size for all parameters, above 0.
    pub learning_rate: f32,
    /// Adam's epsilon, above 0.
    pub adam_epsilon: f32,
    /// Every component of the gradient is clipped to [-`max_gradient`, `max_gradient`], above 0.
    pub max_gradient: f32,
    /// Share of the way that the target critics go to the critics at each gradient step, in (0, 1].
    pub tau: f32,
    /// The temperature alpha, the worth of a nat of entropy.
    pub temperature: Temperature,
    /// Share of a minibatch's windows, in [0, 1], whose first step is drawn from the steps since
    /// the last [`Replay::mark`](crate::Replay::mark); the others are drawn from all. It is rounded
    /// to whole windows: of 512 steps in windows of four, to a multiple of 1 / 128.
    pub newest_share: f32,
    /// Every window of a minibatch is moved by a random element of this group: pictures, vectors
    /// and actions. C1 leaves them as they are.
    pub augmentation: Group,
    /// Weight of the squared distance between the actor's mean action and the stored one, at least
    /// 0: behavioural cloning of what was done (Fujimoto and Gu, NeurIPS 2021, equation 3).
    pub cloning_weight: f32,
}

/// The weight alpha of the entropy.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Temperature {
    /// A constant, at least 0.
    Fixed(f32),
    /// Adjusted such that the entropy of actions is `target` nats for each component: Haarnoja et
    /// al., "Soft actor-critic algorithms and applications" (arXiv 1812.05905, section 5).
    Learned {
        /// Value to begin with, above 0.
        initial: f32,
        /// Entropy in nats of a component of the action; -1 in the paper.
        target: f32,
    },
}

impl SacSettings {
    /// What COVERS lists for CLEAR and 3RL (Liu et al., CoRL 2023, appendix, table "CLEAR and 3RL
    /// Hyperparameter"). What the table does not list: `tau` is that of SAC (arXiv 1801.01290,
    /// table 1), half of a minibatch is the newest experience, steps come in windows of four, which
    /// saves three encodings of eight, and the number of gradient steps is that which makes methods
    /// comparable ([`SacSettings::updates_per_step`]).
    pub fn paper() -> Self {
        let settings = Self {
            gamma: 0.95,
            batch: 512,
            window: 4,
            updates_per_step: 0.0,
            burn_in: 20_000,
            learning_rate: 3e-4,
            adam_epsilon: 1e-8,
            max_gradient: 1.0,
            tau: 0.005,
            temperature: Temperature::Fixed(0.005),
            newest_share: 0.5,
            augmentation: Group::C1,
            cloning_weight: 0.0,
        };
        settings.with_update_ratio_of(&PpoSettings::measured())
    }

    /// The same with the number of gradient steps for which a recorded step is part of as many
    /// gradients as a decision is in PPO: `epochs / batch` for each.
    #[must_use]
    pub fn with_update_ratio_of(self, ppo: &PpoSettings) -> Self {
        Self { updates_per_step: ppo.epochs as f32 / self.batch as f32, ..self }
    }

    /// Refuses values outside their ranges.
    ///
    /// # Errors
    /// [`RlError::Setting`] names the field, its value and its range.
    pub fn check(&self) -> Result<(), RlError> {
        require_share("gamma", self.gamma)?;
        let allowed = (1..=MAX_BATCH).contains(&self.batch);
        require("batch", self.batch as f32, "1 to 65536", allowed)?;
        let whole = self.window > 0 && self.batch.is_multiple_of(self.window);
        require("window", self.window as f32, "a divisor of batch", whole)?;
        let allowed = (0.0..=MAX_UPDATES_PER_STEP).contains(&self.updates_per_step);
        let expected = "a number in [0, 1000]";
        require("updates_per_step", self.updates_per_step, expected, allowed)?;
        require_positive("learning_rate", self.learning_rate)?;
        require_positive("adam_epsilon", self.adam_epsilon)?;
        require_positive("max_gradient", self.max_gradient)?;
        let allowed = self.tau > 0.0 && self.tau <= 1.0;
        require("tau", self.tau, "a number in (0, 1]", allowed)?;
        require_share("newest_share", self.newest_share)?;
        require_weight("cloning_weight", self.cloning_weight)?;
        self.temperature.check()
    }
}

impl Temperature {
    /// Value to begin with, where it is learned.
    pub(super) fn initial(self) -> f32 {
        match self {
            Self::Learned { initial, .. } => initial,
            Self::Fixed(_) => 1.0,
        }
    }

    fn check(self) -> Result<(), RlError> {
        match self {
            Self::Fixed(alpha) => require_weight("temperature", alpha),
            Self::Learned { initial, target } => {
                require_positive("temperature.initial", initial)?;
                let expected = "a finite number";
                require("temperature.target", target, expected, target.is_finite())
            }
        }
    }
}

impl Default for SacSettings {
    fn default() -> Self {
        Self::paper()
    }
}

/// Settings of a context: the last steps of the episode, read by a GRU
/// ([`equivariant::Gru`]). The default is that of 3RL in COVERS (Liu et al., CoRL 2023, appendix).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ContextSettings {
    /// Channels of the GRU's state, at least 1 and a multiple of the order of the network's group.
    pub size: usize,
    /// Steps that it reads at most, in 1..=64.
    pub length: usize,
}

impl Default for ContextSettings {
    fn default() -> Self {
        Self { size: 30, length: 5 }
    }
}
