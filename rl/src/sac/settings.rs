//! Settings of soft actor-critic.

use serde::{Deserialize, Serialize};
use symmetry::Group;

use crate::error::{RlError, require, require_positive, require_share, require_weight};
use crate::ppo::settings::PpoSettings;

/// Maximum number of steps in a minibatch that settings may ask for.
const MAX_BATCH: usize = 1 << 16;
/// Maximum number of gradient steps for one recorded step that settings may ask for.
const MAX_UPDATES_PER_STEP: f32 = 1000.0;
/// Maximum shift of images (pixels) that settings may ask for.
const MAX_RANDOM_SHIFT: usize = 16;

/// Settings of [`crate::Sac`]. [`SacSettings::paper`] is the default.
///
/// In a file, a field that is missing has its default, and one that does not exist is an error.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SacSettings {
    /// Discount factor gamma of the next decision's value, in [0, 1].
    pub gamma: f32,
    /// Number of steps in a minibatch, 1 to 65536.
    pub batch: usize,
    /// Number of consecutive steps of an episode in each window of a minibatch, a divisor of
    /// `batch`. The first step is drawn; an episode's last held step is followed by its first, so
    /// that every step is drawn equally often. A window of the newest steps of an episode with a
    /// [`ReplayBuffer::mark_newest_from_now`](crate::ReplayBuffer::mark_newest_from_now) may
    /// thus reach back before the mark. Steps of a window share observations, each of which is
    /// encoded once: a window of w steps takes w + 1 observations, or w + 1 + L with a context of L
    /// steps, instead of 2 w or (2 + L) w.
    pub window: usize,
    /// Number of gradient steps for each recorded step, in [0, 1000]; below 1, several recorded
    /// steps share a gradient step. Counts all steps ever recorded
    /// ([`Sac::gradient_steps_due`](crate::Sac::gradient_steps_due)).
    ///
    /// By default, 12 / 512: a step recorded after the burn-in is then part of 12 minibatches on
    /// average, the maximum of PPO's default ([`SacSettings::with_update_ratio_of_ppo`]). The
    /// burn-in is not made up for, and PPO may stop early by its KL divergence.
    pub updates_per_step: f32,
    /// Number of recorded steps before the first gradient step.
    pub burn_in: u64,
    /// Adam's step size for all parameters, or for all but those of the image encoder if it has a
    /// step size of its own; above 0.
    pub learning_rate: f32,
    /// Adam's step size for the parameters of the image encoder, above 0; that of all others if
    /// null.
    pub encoder_learning_rate: Option<f32>,
    /// Adam's epsilon, the constant in the denominator of its step, above 0.
    pub adam_epsilon: f32,
    /// Maximum magnitude of each component of the gradient, above 0; larger components are clipped
    /// to it.
    pub max_gradient: f32,
    /// Rate in (0, 1] at which target critics move towards the critics at each gradient step
    /// (Polyak averaging).
    pub tau: f32,
    /// Rate in (0, 1] at which the policy's parameters move towards the trained ones at each
    /// gradient step (Polyak averaging). If null, the policy's are the trained ones.
    pub average_rate: Option<f32>,
    /// Temperature alpha, the weight of the entropy in the actor's objective: fixed or learned.
    pub temperature: EntropyTemperatureSettings,
    /// Share of a minibatch's windows, in [0, 1], whose first step is drawn from the newest steps;
    /// the others are drawn from all. Rounded to whole windows: for 512 steps in windows of four,
    /// to a multiple of 1 / 128. See
    /// [`ReplayBuffer::mark_newest_from_now`](crate::ReplayBuffer::mark_newest_from_now).
    pub newest_share: f32,
    /// Symmetry group for data augmentation: a random element transforms images, vectors and
    /// actions of each window. C1 for none.
    pub augmentation: Group,
    /// Largest random shift of the images of each window (pixels) along rows and columns, at most
    /// 16; 0 for none. Pixels of the edge are repeated (Yarats et al., "Image augmentation is all
    /// you need", ICLR 2021, section 3.1: 4 pixels of 84).
    pub random_shift: usize,
    /// Weight of behavioural cloning, at least 0: of the squared distance between the actor's mean
    /// action and the action in the replay buffer (Fujimoto and Gu, NeurIPS 2021, equation 3).
    pub cloning_weight: f32,
}

/// Temperature alpha, the weight of the entropy in the actor's objective: fixed or learned.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum EntropyTemperatureSettings {
    /// Constant temperature alpha, at least 0.
    Fixed(f32),
    /// Learned temperature alpha, adjusted so that the entropy of actions is `target` nats for each
    /// component. From Haarnoja et al., "Soft actor-critic algorithms and applications" (arXiv
    /// 1812.05905, section 5).
    Learned {
        /// Initial temperature alpha, above 0.
        initial: f32,
        /// Target entropy in nats of each component of the action; -1 in the paper.
        target: f32,
    },
}

impl SacSettings {
    /// Returns the hyper-parameters of COVERS for CLEAR and 3RL (Liu et al., CoRL 2023, appendix,
    /// table "CLEAR and 3RL Hyperparameter"), with this project's choices for those that the table
    /// does not list.
    pub fn paper() -> Self {
        let settings = Self {
            gamma: 0.95,
            batch: 512,
            // five encodings instead of eight
            window: 4,
            // set below, so that a step is part of as many gradients as in PPO
            updates_per_step: 0.0,
            burn_in: 20_000,
            learning_rate: 3e-4,
            encoder_learning_rate: None,
            adam_epsilon: 1e-8,
            max_gradient: 1.0,
            // SAC's (arXiv 1801.01290, table 1)
            tau: 0.005,
            average_rate: None,
            temperature: EntropyTemperatureSettings::Fixed(0.005),
            // CLEAR's even split of new and replayed experience (Rolnick et al., NeurIPS 2019,
            // section 4)
            newest_share: 0.5,
            augmentation: Group::C1,
            random_shift: 0,
            cloning_weight: 0.0,
        };
        settings.with_update_ratio_of_ppo(&PpoSettings::tuned())
    }

    /// Sets [`SacSettings::updates_per_step`] so that a recorded step is part of as many gradients
    /// as a decision is in PPO: to `epochs / batch`.
    #[must_use]
    pub fn with_update_ratio_of_ppo(self, ppo: &PpoSettings) -> Self {
        Self { updates_per_step: ppo.epochs as f32 / self.batch as f32, ..self }
    }

    /// Checks that every setting of soft actor-critic is in its range.
    ///
    /// # Errors
    /// [`RlError::InvalidSetting`] names the field, its value and its range.
    pub fn check(&self) -> Result<(), RlError> {
        require_share("gamma", self.gamma)?;
        let allowed = (1..=MAX_BATCH).contains(&self.batch);
        require("batch", self.batch as f32, "1 to 65536", allowed)?;
        let whole = self.window > 0 && self.batch.is_multiple_of(self.window);
        require("window", self.window as f32, "a divisor of batch", whole)?;
        let updates_fit = (0.0..=MAX_UPDATES_PER_STEP).contains(&self.updates_per_step);
        let expected = "a number in [0, 1000]";
        require("updates_per_step", self.updates_per_step, expected, updates_fit)?;
        require_positive("learning_rate", self.learning_rate)?;
        if let Some(rate) = self.encoder_learning_rate {
            require_positive("encoder_learning_rate", rate)?;
        }
        require_positive("adam_epsilon", self.adam_epsilon)?;
        require_positive("max_gradient", self.max_gradient)?;
        for (name, rate) in [("tau", Some(self.tau)), ("average_rate", self.average_rate)] {
            let rate = rate.unwrap_or(1.0);
            require(name, rate, "a number in (0, 1]", rate > 0.0 && rate <= 1.0)?;
        }
        require_share("newest_share", self.newest_share)?;
        let shift_fits = self.random_shift <= MAX_RANDOM_SHIFT;
        require("random_shift", self.random_shift as f32, "0 to 16 pixels", shift_fits)?;
        require_weight("cloning_weight", self.cloning_weight)?;
        self.temperature.check()
    }
}

impl EntropyTemperatureSettings {
    /// Returns the initial temperature alpha if it is learned, otherwise 1, whose logarithm is 0.
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

/// Settings of a recurrent context of actor and critics: a GRU ([`equivariant::Gru`]) over the last
/// steps of the episode. The default is that of 3RL in COVERS (Liu et al., CoRL 2023, appendix).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecurrentContextSettings {
    /// Number of channels of the GRU's state, a multiple of the order of the network's group.
    pub size: usize,
    /// Maximum number of steps that the GRU reads, in 1..=64.
    pub length: usize,
}

impl Default for RecurrentContextSettings {
    fn default() -> Self {
        Self { size: 30, length: 5 }
    }
}
