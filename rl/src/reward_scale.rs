//! The scale of rewards: what a rollout showed of it, and the range in which algorithms learn.

use std::fmt;

/// Largest magnitude of an episode's return without a warning: beyond it, the gradient of the value
/// function leaves little of the policy's, since both are clipped to one norm.
pub const MAX_RETURN: f64 = 1e3;

/// Smallest magnitude without a warning, but for zero: below it, the errors of a value function
/// that begins to learn are larger than the differences between rewards.
pub const MIN_RETURN: f64 = 1e-2;

/// A return of an episode outside the range in which PPO was seen to learn with its default
/// settings. Nothing in this crate normalises rewards.
///
/// Measured in a task of one step (`tests/reward_scale.rs`), where rewards reach `scale`, after 30
/// rollouts of 512 decisions, as the success of mean actions and of drawn ones:
///
/// | scale | 1e-4 | 1e-3 | 1e-2 | 0.1 | 1 | 10 | 1e2 | 1e3 | 1e4 | 1e5 | 1e6 | 1e7 |
/// |---|---|---|---|---|---|---|---|---|---|---|---|---|
/// | mean | 0.06 | 0.25 | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 | 0.10 |
/// | drawn | 0.11 | 0.16 | 0.45 | 0.89 | 0.90 | 0.84 | 0.37 | 0.36 | 0.34 | 0.24 | 0.16 | 0.13 |
///
/// So learning is best for returns of order 1, and slow at the bounds. A return of zero says
/// nothing: while all rewards are zero, there is no warning. Returns are sums without a discount,
/// so episodes of thousands of steps may exceed the bound although their discounted values do not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RewardWarning {
    /// Returns are beyond [`MAX_RETURN`].
    TooLarge {
        /// Largest magnitude of an episode's return so far.
        largest: f64,
    },
    /// Returns are below [`MIN_RETURN`], though not zero.
    TooSmall {
        /// Largest magnitude of an episode's return so far.
        largest: f64,
    },
}

impl RewardWarning {
    /// Returns the warning for the largest magnitude of an episode's return, if there is one.
    pub fn of(largest: f64) -> Option<Self> {
        if largest > MAX_RETURN {
            Some(Self::TooLarge { largest })
        } else if largest > 0.0 && largest < MIN_RETURN {
            Some(Self::TooSmall { largest })
        } else {
            None
        }
    }
}

impl fmt::Display for RewardWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (largest, effect) = match self {
            Self::TooLarge { largest } => (largest, "exploration may not shrink"),
            Self::TooSmall { largest } => (largest, "little or nothing may be learnt"),
        };
        write!(
            f,
            "returns of episodes reach {largest:.1e} in magnitude, expected between {MIN_RETURN:e} \
             and {MAX_RETURN:e}: {effect}; divide rewards by their usual size in the environment"
        )
    }
}
