//! From how little a learner recognises a group.

use std::collections::BTreeMap;

use envs::{TaskGroup, TaskVariant};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use symmetry::D2;

use crate::error::RunError;
use learner::Learner;

use super::Evaluator;

/// Episodes that are shown: the learner is asked with each of these numbers.
pub const SHOWN: [usize; 3] = [1, 4, 20];

/// Random stream of the seeds of the episodes that are shown.
const EPISODES: u64 = u64::MAX - 1;

/// How often a learner gave one answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Recognition {
    /// The group that was shown.
    pub group: TaskGroup,
    /// The variant's element.
    pub element: D2,
    /// Episodes that were shown each time.
    pub episodes: usize,
    /// The policy that the learner named; none where it named none of them.
    pub policy: Option<usize>,
    /// How often it gave this answer.
    pub times: usize,
}

impl Evaluator {
    /// Shows the learner the first frames of 1, 4 and 20 episodes of a variant, `looks` times each,
    /// and counts what it answers. The episodes depend on the evaluation's seed alone and are
    /// others each time.
    ///
    /// # Errors
    /// What the environments or the learner say.
    pub fn recognition(
        &mut self,
        learner: &mut dyn Learner,
        variant: TaskVariant,
        looks: usize,
    ) -> Result<Vec<Recognition>, RunError> {
        let TaskVariant { group, element } = variant;
        self.labels.set(group.name());
        self.stream.switch_to(group, &[element])?;
        let mut seeds = ChaCha8Rng::seed_from_u64(self.seed);
        seeds.set_stream(EPISODES);
        let mut found = Vec::new();
        for episodes in SHOWN {
            let mut answers: BTreeMap<Option<usize>, usize> = BTreeMap::new();
            for _ in 0..looks {
                let seed: u64 = seeds.random();
                self.stream.reseed(seed)?;
                let rng = &mut super::looking(seed);
                let answer = learner.recognise(&mut self.stream, Some(episodes), rng)?;
                *answers.entry(answer.named()).or_default() += 1;
            }
            found.extend(answers.into_iter().map(|(policy, times)| Recognition {
                group,
                element,
                episodes,
                policy,
                times,
            }));
        }
        Ok(found)
    }
}
