//! The first frames of episodes: what assignment looks at, since later ones depend on the policy.

use cluster::Frames;
use rl::{Observations, Policy, RolloutBuffer};

use crate::CoversError;

/// The first `k` observations of one episode.
pub(crate) type FirstFrames = Observations;

/// Takes the first `k` observations of every episode that begins in `rollout`, which must begin with a reset.
pub(crate) fn first_frames(rollout: &RolloutBuffer, k: usize) -> Vec<FirstFrames> {
    let (envs, steps) = (rollout.spec().num_envs, rollout.steps());
    let mut episodes = Vec::new();
    for env in 0..envs {
        for start in 0..steps {
            let begins = start == 0 || rollout.outcomes()[(start - 1) * envs + env].ended();
            if begins && complete(rollout, env, start, k) {
                episodes.push(copy(rollout, env, start..start + k));
            }
        }
    }
    episodes
}

/// Whether `k` observations of the episode that begins at `start` are there.
fn complete(rollout: &RolloutBuffer, env: usize, start: usize, k: usize) -> bool {
    let envs = rollout.spec().num_envs;
    let ended = |step: usize| rollout.outcomes()[step * envs + env].ended();
    start + k <= rollout.steps() && !(start..start + k - 1).any(ended)
}

fn copy(rollout: &RolloutBuffer, env: usize, steps: std::ops::Range<usize>) -> FirstFrames {
    let (spec, all) = (rollout.spec(), rollout.observations());
    let (image, vector) = (spec.image_len(), spec.vector.len());
    let mut frames = Observations {
        images: Vec::with_capacity(steps.len() * image),
        vectors: Vec::with_capacity(steps.len() * vector),
    };
    for step in steps {
        let row = step * spec.num_envs + env;
        frames
            .images
            .extend(&all.images[row * image..(row + 1) * image]);
        frames
            .vectors
            .extend(&all.vectors[row * vector..(row + 1) * vector]);
    }
    frames
}

/// The invariant features of episodes, as `policy` sees them now: features drift while a policy learns, so frames are embedded afresh.
pub(crate) fn embed<P: Policy>(
    policy: &mut P,
    episodes: &[FirstFrames],
    k: usize,
) -> Result<Frames, CoversError> {
    let (frames, dim) = (episodes.len() * k, policy.feature_dim());
    let mut all = Observations {
        images: Vec::new(),
        vectors: Vec::new(),
    };
    for episode in episodes {
        all.images.extend(&episode.images);
        all.vectors.extend(&episode.vectors);
    }
    let mut features = vec![0.0; frames * dim];
    policy.features(&all, &mut features)?;
    Ok(Frames::new(features, k, dim)?)
}
