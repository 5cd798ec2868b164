//! One policy of the collection, and what a grouping sees of all of them.

use cluster::{Candidate, Contest, Reservoir};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::error::CoversError;
use crate::groupings::{Candidates, Episodes};

use super::first_frames::{FirstFrames, embed};
use super::settings::{CollectionSettings, PolicyOf};

/// A policy, its training, and the first frames of the group that it oversees.
pub(super) struct Member<S: CollectionSettings> {
    pub policy: PolicyOf<S>,
    pub training: S::Training,
    pub buffer: Reservoir<FirstFrames>,
}

/// The members beside the first frames of a rollout.
pub(super) struct Clouds<'a, S: CollectionSettings> {
    pub members: &'a mut [Member<S>],
    pub rollout: &'a [FirstFrames],
    pub episodes: Episodes<'a>,
}

impl<S: CollectionSettings> Candidates for Clouds<'_, S> {
    fn clouds(&mut self) -> Result<Vec<Candidate>, CoversError> {
        let clouds = self.members.iter_mut().map(|member| {
            Ok(Candidate {
                buffer: embed(&mut member.policy, member.buffer.episodes())?,
                rollout: embed(&mut member.policy, self.rollout)?,
            })
        });
        clouds.collect()
    }

    fn contests(&mut self, rivals: [usize; 2], most: usize) -> Result<[Contest; 2], CoversError> {
        let members = self.members.iter_mut();
        let (mut policies, buffers): (Vec<_>, Vec<_>) = members
            .map(|member| {
                let kept = member.buffer.episodes();
                (&mut member.policy, &kept[..kept.len().min(most)])
            })
            .unzip();
        let mut contest = |policy: usize| -> Result<Contest, CoversError> {
            let policy = &mut *policies[policy];
            let [first, second] = rivals.map(|rival| embed(policy, buffers[rival]));
            Ok(Contest {
                rollout: embed(policy, self.rollout)?,
                rivals: [first?, second?],
            })
        };
        let [first, second] = rivals.map(&mut contest);
        Ok([first?, second?])
    }

    fn began(&self) -> Vec<usize> {
        self.rollout.iter().map(FirstFrames::began).collect()
    }

    fn episodes(&self) -> Episodes<'_> {
        self.episodes
    }
}

/// Random generators of the learner; each purpose has its own, so that none shifts another.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Generators {
    pub actions: ChaCha8Rng,
    pub updates: ChaCha8Rng,
    pub assignment: ChaCha8Rng,
    pub initialisation: ChaCha8Rng,
}

impl Generators {
    pub fn new(seed: u64) -> Self {
        let stream = |index| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(index);
            rng
        };
        Self {
            actions: stream(0),
            updates: stream(1),
            assignment: stream(2),
            initialisation: stream(3),
        }
    }
}
