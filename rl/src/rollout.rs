//! Collection of experience: T steps of N environments with the stochastic policy.

use rand_chacha::ChaCha8Rng;

use crate::buffer::RolloutBuffer;
use crate::env::{EnvSpec, Observations, Outcome, Transition, VectorEnv};
use crate::error::{RlError, check_len};
use crate::policy::{Decisions, Policy};

/// Where N environments stand between two rollouts. The fields are the whole state.
#[derive(Clone, Debug, PartialEq)]
pub struct RolloutState {
    /// What the policy acts on next.
    pub observations: Observations,
    /// The running episodes so far, `[N]`.
    pub episodes: Vec<Episode>,
}

/// One episode: so far, or as it ended.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Episode {
    /// Index of the environment, in 0..N.
    pub env: usize,
    /// Number of steps.
    pub length: usize,
    /// Undiscounted sum of rewards.
    pub total_reward: f64,
    /// Whether the success condition held at any time of the episode.
    pub success: bool,
    /// Whether the success condition held at the end of the last step.
    pub success_at_end: bool,
}

/// The episodes that ended during a rollout.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RolloutStats {
    /// T * N, the number of decisions taken.
    pub decisions: usize,
    /// Episodes in the order in which they ended.
    pub episodes: Vec<Episode>,
}

impl RolloutStats {
    /// Mean undiscounted return; `None` when no episode ended.
    pub fn mean_return(&self) -> Option<f64> {
        self.mean(|e| e.total_reward)
    }

    /// Share in [0, 1] of episodes with success at any time; `None` when no episode ended.
    pub fn success_rate(&self) -> Option<f64> {
        self.mean(|e| f64::from(u8::from(e.success)))
    }

    /// Share in [0, 1] of episodes with success at the end of their last step;
    /// `None` when no episode ended.
    pub fn success_at_end_rate(&self) -> Option<f64> {
        self.mean(|e| f64::from(u8::from(e.success_at_end)))
    }

    fn mean(&self, of: impl Fn(&Episode) -> f64) -> Option<f64> {
        let count = self.episodes.len();
        (count > 0).then(|| self.episodes.iter().map(of).sum::<f64>() / count as f64)
    }
}

impl RolloutState {
    /// Starts an episode in every environment.
    ///
    /// # Errors
    /// [`RlError::Environment`] when the reset fails, [`RlError::Shape`] when it changes the sizes of its output.
    pub fn reset(env: &mut dyn VectorEnv) -> Result<Self, RlError> {
        let spec = env.spec().clone();
        spec.check()?;
        let mut observations = Observations::new(&spec);
        env.reset(&mut observations).map_err(RlError::Environment)?;
        observations.check(&spec, spec.num_envs)?;
        Ok(Self {
            observations,
            episodes: (0..spec.num_envs).map(fresh).collect(),
        })
    }

    /// Books one step and moves on to its observations; episodes that ended go to `ended`.
    pub(crate) fn advance(&mut self, transition: &mut Transition, ended: &mut Vec<Episode>) {
        std::mem::swap(&mut self.observations, &mut transition.observations);
        for (n, episode) in self.episodes.iter_mut().enumerate() {
            episode.length += 1;
            episode.total_reward += f64::from(transition.rewards[n]);
            episode.success |= transition.success[n];
            episode.success_at_end = transition.success_at_end[n];
            if transition.outcomes[n].ended() {
                ended.push(std::mem::replace(episode, fresh(n)));
            }
        }
    }
}

fn fresh(env: usize) -> Episode {
    Episode {
        env,
        ..Episode::default()
    }
}

/// Clears `buffer`, runs the stochastic policy for its T steps (T * N decisions) from `state` on, and finishes it with
/// the values that advantages need. Environments restart by themselves; episodes may span rollouts.
///
/// # Errors
/// [`RlError::Environment`] when a step fails, [`RlError::Shape`] when the sizes of environment, policy, state and
/// buffer differ, [`RlError::NotFinite`] for a reward that is not a number.
pub fn collect<P: Policy>(
    env: &mut dyn VectorEnv,
    policy: &mut P,
    buffer: &mut RolloutBuffer,
    state: &mut RolloutState,
    rng: &mut ChaCha8Rng,
) -> Result<RolloutStats, RlError> {
    let spec = env.spec().clone();
    check_len("episodes", "[N]", state.episodes.len(), spec.num_envs)?;
    let mut scratch = Scratch::new(&spec);
    let mut ended = Vec::new();
    buffer.clear();
    for _ in 0..buffer.steps() {
        policy.act(&state.observations, rng, &mut scratch.decisions)?;
        env.step(&scratch.decisions.actions, &mut scratch.transition)
            .map_err(RlError::Environment)?;
        scratch.value_truncated(policy)?;
        buffer.push(
            &state.observations,
            &scratch.decisions,
            &scratch.transition,
            &scratch.final_values,
        )?;
        state.advance(&mut scratch.transition, &mut ended);
    }
    policy.values(&state.observations, &mut scratch.final_values)?;
    buffer.finish(&state.observations, &scratch.final_values)?;
    Ok(RolloutStats {
        decisions: buffer.samples(),
        episodes: ended,
    })
}

/// What one step writes, reused from step to step.
struct Scratch {
    transition: Transition,
    decisions: Decisions,
    final_values: Vec<f32>,
}

impl Scratch {
    fn new(spec: &EnvSpec) -> Self {
        Self {
            transition: Transition::new(spec),
            decisions: Decisions::new(spec),
            final_values: vec![0.0; spec.num_envs],
        }
    }

    /// Asks for the values of the final observations where a truncation will bootstrap them.
    fn value_truncated<P: Policy>(&mut self, policy: &mut P) -> Result<(), RlError> {
        if self.transition.outcomes.contains(&Outcome::Truncated) {
            policy.values(&self.transition.final_observations, &mut self.final_values)?;
        }
        Ok(())
    }
}
