//! One policy for everything.

use cluster::{Assignment, Decision};
use rand_chacha::ChaCha8Rng;

use super::grouping::{Answer, Candidates, Grouping};

/// Gives every rollout to policy 0: the paper's baselines Equi and CNN.
#[derive(Clone, Copy, Debug, Default)]
pub struct Single;

impl Grouping for Single {
    fn min_episodes(&self) -> usize {
        1
    }

    fn assign(&self, _: &mut dyn Candidates, _: &mut ChaCha8Rng) -> Answer {
        Ok(Assignment {
            decision: Decision::Existing(0),
            evidence: Vec::new(),
        })
    }
}
