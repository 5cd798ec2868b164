//! Evaluation: whole episodes with the mean action.

use crate::env::{Transition, VectorEnv};
use crate::error::RlError;
use crate::policy::Actor;
use crate::rollout::{RolloutState, RolloutStats, step};

/// Resets the environments and runs the first `rounds` episodes of each with the actor's mean
/// actions.
///
/// Episodes must end, by themselves or by a time limit: an environment that runs for ever is
/// evaluated for ever. Counting the same number of episodes in every environment keeps short
/// episodes from being over-represented.
///
/// # Errors
/// [`RlError::Environment`] when a step fails, [`RlError::Shape`] when environment and actor differ
/// in size, [`RlError::NotFinite`] for rewards, observations or actions that are not numbers.
pub fn evaluate<A: Actor>(
    env: &mut dyn VectorEnv,
    actor: &mut A,
    rounds: usize,
) -> Result<RolloutStats, RlError> {
    watch(env, actor, rounds, |_, _| Ok(()))
}

/// Evaluates as [`evaluate`] does. Before every decision `look` sees the actor and where the
/// environments stand.
///
/// # Errors
/// As there, and what `look` says.
pub fn watch<A: Actor>(
    env: &mut dyn VectorEnv,
    actor: &mut A,
    rounds: usize,
    mut look: impl FnMut(&A, &RolloutState<A::Memory>) -> Result<(), RlError>,
) -> Result<RolloutStats, RlError> {
    let spec = env.spec().clone();
    let mut state = RolloutState::reset(env, actor)?;
    let mut transition = Transition::new(&spec);
    let mut actions = vec![0.0; spec.num_envs * spec.action.len()];
    let mut left = vec![rounds; spec.num_envs];
    let mut stats = RolloutStats::default();
    while left.iter().any(|&rounds| rounds > 0) {
        look(actor, &state)?;
        actor.mean_actions(&state.observations, &mut state.memory, &mut actions)?;
        step(env, &state.episodes, &actions, &mut transition)?;
        state.remember(&actions, &transition.rewards);
        let ended = state.advance(&mut transition);
        stats.book(&ended, &state.episodes);
        for episode in ended {
            if left[episode.env] > 0 {
                left[episode.env] -= 1;
                stats.episodes.push(episode);
            }
        }
    }
    Ok(stats)
}
