//! Grouping by the 1-Wasserstein distance of invariant features.

use cluster::{Assigner, AssignerSettings, Rule};
use rand_chacha::ChaCha8Rng;

use crate::error::CoversError;

use super::grouping::{Answer, Candidates, Grouping};

/// Compares the rollout's first frames `O` with every policy's `B`, in that policy's own features:
/// by a calibrated test, or by the paper's threshold.
#[derive(Clone, Copy, Debug)]
pub struct Distance(Assigner);

impl Distance {
    /// Takes the rule that accepts or refuses a policy.
    ///
    /// # Errors
    /// A setting of the rule out of range.
    pub fn new(rule: Rule) -> Result<Self, CoversError> {
        Ok(Self(Assigner::new(AssignerSettings { rule })?))
    }
}

impl Grouping for Distance {
    fn min_episodes(&self) -> usize {
        match &self.0.settings().rule {
            Rule::Fixed { .. } => 1,
            Rule::Calibrated(calibrated) => calibrated.min_episodes,
        }
    }

    fn assign(&self, candidates: &mut dyn Candidates, rng: &mut ChaCha8Rng) -> Answer {
        Ok(self.0.assign(&candidates.clouds()?, rng)?)
    }

    fn recognise(&self, candidates: &mut dyn Candidates, rng: &mut ChaCha8Rng) -> Answer {
        Ok(self.0.recognise(&candidates.clouds()?, rng)?)
    }

    fn settle(&self, candidates: &mut dyn Candidates, rng: &mut ChaCha8Rng) -> Answer {
        Ok(self.0.settle(&candidates.clouds()?, rng)?)
    }
}
