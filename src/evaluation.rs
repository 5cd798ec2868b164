//! Evaluation: the policy that the learner itself recognises, acting by its mean.

use envs::TaskGroup;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::stream::Stream;
use crate::{Covers, CoversError};

/// Results of one group.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Score {
    /// The group's name.
    pub group: String,
    /// Index of the policy that the learner chose for it.
    pub policy: usize,
    /// Episodes evaluated.
    pub episodes: usize,
    /// Share of episodes in which the success condition held at any step, in `[0, 1]`.
    pub success: f64,
    /// Share of episodes in which it held at the last step, in `[0, 1]`.
    pub success_at_end: f64,
    /// Mean return on the paper's scale, in `[0, 500]`.
    pub reward: f64,
}

/// Runs `rounds` episodes in each of the stream's environments on `group`, with one policy, which the learner
/// chooses beforehand from the first frames of other episodes; nobody tells it the group.
///
/// # Errors
/// [`CoversError::Setting`] for no rounds; what the environments, the policies or the assigner say.
pub fn evaluate(
    covers: &mut Covers,
    stream: &mut Stream,
    group: TaskGroup,
    rounds: usize,
    rng: &mut ChaCha8Rng,
) -> Result<Score, CoversError> {
    if rounds == 0 {
        return Err(CoversError::Setting {
            name: "rounds",
            value: "0".to_owned(),
            expected: "at least 1",
        });
    }
    stream.switch_to(group)?;
    let policy = covers.recognise(stream, rng)?;
    let stats = covers.perform(policy, stream, rounds)?;
    Ok(Score {
        group: group.to_string(),
        policy,
        episodes: stats.episodes.len(),
        success: stats.success_rate().unwrap_or(0.0),
        success_at_end: stats.success_at_end_rate().unwrap_or(0.0),
        reward: stats.mean_return().unwrap_or(0.0) * stream.reward_scale(),
    })
}
