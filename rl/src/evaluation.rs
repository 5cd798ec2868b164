//! Evaluation: whole episodes with the mean action.

use crate::env::{Transition, VectorEnv};
use crate::error::RlError;
use crate::policy::Policy;
use crate::rollout::{RolloutState, RolloutStats};

/// Resets the environments and runs the first `rounds` episodes of each with the policy's mean actions.
///
/// Episodes must end, by themselves or by a time limit: an environment that runs for ever is evaluated for ever.
/// Counting the same number of episodes in every environment keeps short episodes from being over-represented.
///
/// # Errors
/// [`RlError::Environment`] when a step fails, [`RlError::Shape`] when environment and policy differ in size.
pub fn evaluate<P: Policy>(
    env: &mut dyn VectorEnv,
    policy: &mut P,
    rounds: usize,
) -> Result<RolloutStats, RlError> {
    let spec = env.spec().clone();
    let mut state = RolloutState::reset(env)?;
    let mut transition = Transition::new(&spec);
    let mut actions = vec![0.0; spec.num_envs * spec.action.len()];
    let mut left = vec![rounds; spec.num_envs];
    let mut stats = RolloutStats::default();
    while left.iter().any(|&rounds| rounds > 0) {
        policy.mean_actions(&state.observations, &mut actions)?;
        env.step(&actions, &mut transition)
            .map_err(RlError::Environment)?;
        stats.decisions += spec.num_envs;
        let mut ended = Vec::new();
        state.advance(&mut transition, &mut ended);
        for episode in ended {
            if left[episode.env] > 0 {
                left[episode.env] -= 1;
                stats.episodes.push(episode);
            }
        }
    }
    Ok(stats)
}
