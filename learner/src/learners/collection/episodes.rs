//! Episodes of a rollout: their first frames, by which rollouts are assigned since later frames
//! depend on the policy, and whole trajectories for groupings that need them.

use std::ops::Range;

use cluster::FrameFeatures;
use evidence::Trajectory;
use rl::{EnvSpec, FeatureExtractor, Observations, RlError, RolloutBuffer, StepOutcome};

use crate::error::LearnerError;

/// First observations of one episode, by which its rollout is assigned to a policy.
pub(super) struct FirstFrames {
    /// Number of decisions of all environments from the start of the rollout to that of the
    /// episode.
    began: usize,
    count: usize,
    observations: Observations,
}

impl FirstFrames {
    /// Creates the first frames of an episode from its first `count` observations.
    pub(super) fn new(count: usize, observations: Observations) -> Self {
        Self { began: 0, count, observations }
    }

    /// Returns the number of first frames of the episode.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Returns the episode's first observations.
    pub(super) fn observations(&self) -> &Observations {
        &self.observations
    }
}

/// Data of episodes by which a rollout is assigned to a policy: first frames and trajectories.
#[derive(Default)]
pub(super) struct ObservedEpisodes {
    /// First frames of the episodes: the paper's `O`.
    pub frames: Vec<FirstFrames>,
    /// Whole episodes; empty if the grouping does not need them.
    pub trajectories: Vec<Trajectory>,
}

impl ObservedEpisodes {
    /// Appends the episodes of a later rollout.
    pub fn extend(&mut self, later: Self) {
        self.frames.extend(later.frames);
        self.trajectories.extend(later.trajectories);
    }

    /// Removes the first frames of episodes that began before a changepoint, which belong to the
    /// earlier task group; trajectories stay. If all episodes began before it, all stay.
    pub fn drop_frames_before_changepoint(&mut self, changepoint: Option<usize>) {
        // `None` is less than any `Some`, so without a changepoint all frames are later
        let is_later = |episode: &FirstFrames| Some(episode.began) >= changepoint;
        if self.frames.iter().any(is_later) {
            self.frames.retain(is_later);
        }
    }
}

/// Rollout of a policy: the steps of all environments since their last reset.
pub trait Rollout {
    /// Returns the sizes and symmetry types of the environments of the rollout.
    fn spec(&self) -> &EnvSpec;

    /// Returns T, the number of steps of every environment that were collected.
    fn num_steps(&self) -> usize;

    /// Returns step `step` (from 0) of environment `env` (from 0) in the rollout.
    fn step(&self, step: usize, env: usize) -> SingleEnvStep<'_>;

    /// Removes the steps of the rollout after the first `steps`, at least 1.
    ///
    /// # Errors
    /// A rollout that is not finished.
    fn truncate(&mut self, steps: usize) -> Result<(), RlError>;

    /// Removes all but the latest `rollouts` that were collected since the algorithm last trained.
    /// The default is for storage that the next rollout overwrites.
    fn keep_latest(&mut self, _rollouts: usize) {}
}

/// Step of one environment in a rollout.
pub struct SingleEnvStep<'a> {
    /// Picture `[height, width, channels]` that the policy acted on.
    pub image: &'a [u8],
    /// Observation vector that the policy acted on.
    pub vector: &'a [f32],
    /// Action executed in the step, one entry per action dimension.
    pub action: &'a [f32],
    /// Reward of the step.
    pub reward: f32,
    /// State of the episode after the step.
    pub outcome: StepOutcome,
}

impl Rollout for RolloutBuffer {
    fn spec(&self) -> &EnvSpec {
        self.spec()
    }

    fn num_steps(&self) -> usize {
        self.steps_per_env()
    }

    fn step(&self, step: usize, env: usize) -> SingleEnvStep<'_> {
        let (row, len) = (step * self.spec().num_envs + env, self.spec().action_irreps.len());
        let (image, vector) = self.observations().image_and_vector(self.spec(), row);
        SingleEnvStep {
            image,
            vector,
            action: &self.decisions().actions[row * len..(row + 1) * len],
            reward: self.rewards()[row],
            outcome: self.outcomes()[row],
        }
    }

    fn truncate(&mut self, steps: usize) -> Result<(), RlError> {
        self.truncate(steps)
    }
}

/// Steps of one episode in a rollout.
struct EpisodeSpan {
    env: usize,
    steps: Range<usize>,
    is_whole: bool,
}

/// Returns the steps of every episode of a rollout, one environment after the other.
fn episode_spans<R: Rollout>(rollout: &R) -> Vec<EpisodeSpan> {
    let mut spans = Vec::new();
    for env in 0..rollout.spec().num_envs {
        let mut start = 0;
        while start < rollout.num_steps() {
            let end =
                (start..rollout.num_steps()).find(|&t| rollout.step(t, env).outcome.is_ended());
            let stop = end.map_or(rollout.num_steps(), |last| last + 1);
            spans.push(EpisodeSpan { env, steps: start..stop, is_whole: end.is_some() });
            start = stop;
        }
    }
    spans
}

/// Returns the first `k` observations of each of a rollout's episodes that has at least `k`.
pub(super) fn first_frames<R: Rollout>(rollout: &R, k: usize) -> Vec<FirstFrames> {
    let (envs, mut episodes) = (rollout.spec().num_envs, Vec::new());
    for EpisodeSpan { env, steps, .. } in episode_spans(rollout) {
        if steps.len() < k {
            continue;
        }
        let mut frames = Observations {
            images: Vec::with_capacity(k * rollout.spec().image_len()),
            vectors: Vec::with_capacity(k * rollout.spec().vector_irreps.len()),
        };
        for step in steps.start..steps.start + k {
            let SingleEnvStep { image, vector, .. } = rollout.step(step, env);
            frames.images.extend(image);
            frames.vectors.extend(vector);
        }
        episodes.push(FirstFrames { began: steps.start * envs, ..FirstFrames::new(k, frames) });
    }
    episodes
}

/// Returns the trajectory of every episode of a rollout, unfinished ones included.
pub(super) fn trajectories<R: Rollout>(rollout: &R) -> Vec<Trajectory> {
    let (envs, mut trajectories) = (rollout.spec().num_envs, Vec::new());
    for span in episode_spans(rollout) {
        let mut trajectory = Trajectory {
            began: span.steps.start * envs,
            is_whole: span.is_whole,
            image: rollout.step(span.steps.start, span.env).image.to_vec(),
            ..Trajectory::default()
        };
        for step in span.steps {
            let step = rollout.step(step, span.env);
            trajectory.vectors.extend(step.vector);
            trajectory.actions.extend(step.action);
            trajectory.rewards.push(step.reward);
        }
        trajectories.push(trajectory);
    }
    trajectories
}

/// Computes the invariant features of episodes' first frames by the network of `policy`: features
/// drift while a policy trains, so none are stored.
pub(super) fn embed_first_frames<P: FeatureExtractor>(
    policy: &mut P,
    episodes: &[FirstFrames],
) -> Result<FrameFeatures, LearnerError> {
    let dim = policy.feature_dim();
    let per_episode = episodes.first().map_or(0, |episode| episode.count);
    let mut all = Observations { images: Vec::new(), vectors: Vec::new() };
    for episode in episodes {
        all.images.extend(&episode.observations.images);
        all.vectors.extend(&episode.observations.vectors);
    }
    let mut features = vec![0.0; episodes.len() * per_episode * dim];
    policy.features(&all, &mut features)?;
    Ok(FrameFeatures::new(features, per_episode, dim)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rl::{Decisions, Transition};
    use symmetry::Irrep;

    /// Five steps of two environments; pixels and vectors carry `10 env + step`. `ends` lists (env,
    /// step) after which an episode ends.
    fn rollout(ends: &[(usize, usize)]) -> RolloutBuffer {
        let spec = EnvSpec {
            num_envs: 2,
            image_shape: [1, 1, 1],
            vector_irreps: vec![Irrep::X],
            action_irreps: vec![Irrep::X],
            choices: vec![],
        };
        let mut buffer = RolloutBuffer::new(&spec, 5).unwrap();
        for step in 0..5 {
            let marks = [step as u8, 10 + step as u8];
            let observations =
                Observations { images: marks.to_vec(), vectors: marks.map(f32::from).to_vec() };
            let mut transition = Transition::new(&spec);
            for (env, outcome) in transition.outcomes.iter_mut().enumerate() {
                if ends.contains(&(env, step)) {
                    *outcome = StepOutcome::Truncated;
                }
            }
            let decisions = Decisions::new(&spec);
            buffer.push(&observations, &decisions, &transition, &[0.0; 2]).unwrap();
        }
        buffer
    }

    fn images(rollout: &RolloutBuffer, k: usize) -> Vec<Vec<u8>> {
        let episodes = first_frames(rollout, k).into_iter();
        episodes.map(|episode| episode.observations.images).collect()
    }

    #[test]
    fn every_episode_that_is_long_enough_gives_its_first_frames() {
        let two_ends = rollout(&[(0, 2), (1, 4)]);
        assert_eq!(images(&two_ends, 2), [vec![0, 1], vec![3, 4], vec![10, 11]]);
        assert_eq!(images(&two_ends, 1), [vec![0], vec![3], vec![10]]);
        // environment 0: steps 0 | 1, 2 | 3, 4 (still running); environment 1: one long episode
        let short = rollout(&[(0, 0), (0, 2)]);
        assert_eq!(images(&short, 2), [vec![1, 2], vec![3, 4], vec![10, 11]]);
        assert_eq!(images(&short, 3), [vec![10, 11, 12]]);
    }
}
