//! Recognition test: the policy that a learner names for a group from few episodes.

use std::collections::BTreeMap;

use envs::TaskVariant;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::error::RunError;
use crate::schema::RecognitionRow;
use learner::Learner;

use super::Evaluator;

/// Numbers of episodes that the recognition test shows: from their first frames the learner must
/// name the policy of a task variant. With each number it is asked
/// [`EvaluationPlan::recognition_repeats`](crate::EvaluationPlan::recognition_repeats) times.
pub const RECOGNITION_EPISODE_COUNTS: [usize; 3] = [1, 4, 20];

/// Number of the ChaCha stream for the seeds of shown episodes, next to that of the learner's
/// draws.
const EPISODES: u64 = u64::MAX - 1;

impl Evaluator {
    /// Shows the learner the first frames of 1, 4 and 20 episodes of a variant, `repeats` times each,
    /// and counts how often it names each policy or none. Each time the episodes are different;
    /// they depend on the evaluation's seed alone.
    ///
    /// # Errors
    /// Errors of the environments or the learner.
    pub fn test_recognition(
        &mut self,
        learner: &mut dyn Learner,
        variant: TaskVariant,
        repeats: usize,
    ) -> Result<Vec<RecognitionRow>, RunError> {
        let TaskVariant { group, element } = variant;
        self.labels.set(group.name());
        self.stream.switch_task_group(group, &[element])?;
        let mut seeds = ChaCha8Rng::seed_from_u64(self.episode_seed(variant));
        seeds.set_stream(EPISODES);
        let mut found = Vec::new();
        for episodes in RECOGNITION_EPISODE_COUNTS {
            let mut answers: BTreeMap<Option<usize>, usize> = BTreeMap::new();
            for _ in 0..repeats {
                let seed: u64 = seeds.random();
                self.stream.reseed(seed)?;
                let rng = &mut super::recognition_rng(seed);
                let answer = learner.recognise_policy(&mut self.stream, Some(episodes), rng)?;
                *answers.entry(answer.accepted_policy()).or_default() += 1;
            }
            found.extend(answers.into_iter().map(|(policy, times)| RecognitionRow {
                group: group.name().to_owned(),
                element: element.to_string(),
                episodes_shown: episodes,
                policy,
                count: times,
            }));
        }
        Ok(found)
    }
}
