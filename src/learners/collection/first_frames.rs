//! The first frames of episodes: what assignment looks at, since later ones depend on the policy.

use cluster::Frames;
use rl::{EnvSpec, Features, Observations, Outcome, RlError, RolloutBuffer};

use crate::error::CoversError;

/// The first observations of one episode.
pub(super) struct FirstFrames {
    /// Decisions of all environments before it, since the look began that it is of.
    began: usize,
    count: usize,
    observations: Observations,
}

impl FirstFrames {
    /// The first `count` observations of an episode.
    pub(super) fn new(count: usize, observations: Observations) -> Self {
        Self {
            began: 0,
            count,
            observations,
        }
    }

    /// Decisions of all environments before it, since the look began that it is of.
    pub(super) fn began(&self) -> usize {
        self.began
    }

    /// The number of observations.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// The observations.
    pub(super) fn observations(&self) -> &Observations {
        &self.observations
    }
}

/// What one collection showed.
pub trait Rollout {
    /// The environments.
    fn spec(&self) -> &EnvSpec;

    /// T, the steps of every environment that were collected.
    fn shown(&self) -> usize;

    /// How step `step` of environment `env` left its episode.
    fn outcome(&self, step: usize, env: usize) -> Outcome;

    /// The picture `[H, W, C]` and the vector `[D]` that were acted on.
    fn observation(&self, step: usize, env: usize) -> (&[u8], &[f32]);

    /// The action `[A]`.
    fn action(&self, step: usize, env: usize) -> &[f32];

    /// What it was rewarded with.
    fn reward(&self, step: usize, env: usize) -> f32;

    /// Forgets all steps of the last collection but the first `steps`, at least 1.
    ///
    /// # Errors
    /// A collection that is not finished.
    fn truncate(&mut self, steps: usize) -> Result<(), RlError>;

    /// Keeps the latest `collections` of those since an algorithm learnt last. One that holds a
    /// single collection forgets it when the next one begins.
    fn keep(&mut self, _collections: usize) {}
}

impl Rollout for RolloutBuffer {
    fn spec(&self) -> &EnvSpec {
        self.spec()
    }

    fn shown(&self) -> usize {
        self.steps()
    }

    fn outcome(&self, step: usize, env: usize) -> Outcome {
        self.outcomes()[step * self.spec().num_envs + env]
    }

    fn observation(&self, step: usize, env: usize) -> (&[u8], &[f32]) {
        let row = step * self.spec().num_envs + env;
        self.observations().sample(self.spec(), row)
    }

    fn action(&self, step: usize, env: usize) -> &[f32] {
        let (row, len) = (step * self.spec().num_envs + env, self.spec().action.len());
        &self.decisions().actions[row * len..(row + 1) * len]
    }

    fn reward(&self, step: usize, env: usize) -> f32 {
        self.rewards()[step * self.spec().num_envs + env]
    }

    fn truncate(&mut self, steps: usize) -> Result<(), RlError> {
        self.truncate(steps)
    }
}

/// Takes the first `k` observations of every episode that begins in `rollout`, which must begin
/// with a reset after `before` decisions.
pub(super) fn first_frames<R: Rollout>(rollout: &R, before: usize, k: usize) -> Vec<FirstFrames> {
    let mut episodes = Vec::new();
    let envs = rollout.spec().num_envs;
    for env in 0..envs {
        for start in 0..rollout.shown() {
            let begins = start == 0 || rollout.outcome(start - 1, env).ended();
            if begins && complete(rollout, env, start, k) {
                episodes.push(FirstFrames {
                    began: before + start * envs,
                    ..copy(rollout, env, start..start + k)
                });
            }
        }
    }
    episodes
}

/// Leaves out what began before a cut, which is of the group before. All stay where no later one
/// showed enough observations.
pub(super) fn keep_later(episodes: &mut Vec<FirstFrames>, cut: Option<usize>) {
    let is_later = |episode: &FirstFrames| Some(episode.began) >= cut;
    if episodes.iter().any(is_later) {
        episodes.retain(is_later);
    }
}

/// Whether `k` observations of the episode that begins at `start` are there.
fn complete<R: Rollout>(rollout: &R, env: usize, start: usize, k: usize) -> bool {
    let ended = |step: usize| rollout.outcome(step, env).ended();
    start + k <= rollout.shown() && !(start..start + k - 1).any(ended)
}

fn copy<R: Rollout>(rollout: &R, env: usize, steps: std::ops::Range<usize>) -> FirstFrames {
    let (image, vector) = (rollout.spec().image_len(), rollout.spec().vector.len());
    let count = steps.len();
    let mut frames = Observations {
        images: Vec::with_capacity(count * image),
        vectors: Vec::with_capacity(count * vector),
    };
    for step in steps {
        let (image, vector) = rollout.observation(step, env);
        frames.images.extend(image);
        frames.vectors.extend(vector);
    }
    FirstFrames::new(count, frames)
}

/// The invariant features of episodes, as `policy` sees them now: features drift while a policy
/// learns, so frames are embedded afresh.
pub(super) fn embed<P: Features>(
    policy: &mut P,
    episodes: &[FirstFrames],
) -> Result<Frames, CoversError> {
    let dim = policy.feature_dim();
    let per_episode = episodes.first().map_or(0, |episode| episode.count);
    let mut all = Observations {
        images: Vec::new(),
        vectors: Vec::new(),
    };
    for episode in episodes {
        all.images.extend(&episode.observations.images);
        all.vectors.extend(&episode.observations.vectors);
    }
    let mut features = vec![0.0; episodes.len() * per_episode * dim];
    policy.features(&all, &mut features)?;
    Ok(Frames::new(features, per_episode, dim)?)
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
            image: [1, 1, 1],
            vector: vec![Irrep::X],
            action: vec![Irrep::X],
        };
        let mut buffer = RolloutBuffer::new(&spec, 5).unwrap();
        for step in 0..5 {
            let marks = [step as u8, 10 + step as u8];
            let observations = Observations {
                images: marks.to_vec(),
                vectors: marks.map(f32::from).to_vec(),
            };
            let mut transition = Transition::new(&spec);
            for (env, outcome) in transition.outcomes.iter_mut().enumerate() {
                if ends.contains(&(env, step)) {
                    *outcome = Outcome::Truncated;
                }
            }
            let decisions = Decisions::new(&spec);
            buffer
                .push(&observations, &decisions, &transition, &[0.0; 2])
                .unwrap();
        }
        buffer
    }

    fn images(rollout: &RolloutBuffer, k: usize) -> Vec<Vec<u8>> {
        let episodes = first_frames(rollout, 0, k).into_iter();
        episodes
            .map(|episode| episode.observations.images)
            .collect()
    }

    #[test]
    fn every_episode_gives_its_first_frames() {
        let rollout = rollout(&[(0, 2), (1, 4)]);
        assert_eq!(images(&rollout, 2), [vec![0, 1], vec![3, 4], vec![10, 11]]);
        assert_eq!(images(&rollout, 1), [vec![0], vec![3], vec![10]]);
    }

    #[test]
    fn episodes_that_are_too_short_give_nothing() {
        // environment 0: steps 0 | 1, 2 | 3, 4 (still running); environment 1: one long episode
        let rollout = rollout(&[(0, 0), (0, 2)]);
        assert_eq!(images(&rollout, 2), [vec![1, 2], vec![3, 4], vec![10, 11]]);
        assert_eq!(images(&rollout, 3), [vec![10, 11, 12]]);
    }
}
