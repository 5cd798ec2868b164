//! What every learner can do.

use std::path::Path;

use cluster::Evidence;
use rand_chacha::ChaCha8Rng;
use rl::{Activity, Answers, Observations, PlainPolicy, RolloutStats, VectorEnv};

use crate::disk::{LocalDisk, replace};
use crate::error::CoversError;
use crate::groupings::Recognised;

use super::metrics::Metrics;

/// Learns from a stream of tasks. No method has a place for a task's label.
pub trait Learner: Send {
    /// One turn: collects experience in `env` and learns from it. Episodes begin anew.
    ///
    /// # Errors
    /// What the environment, a policy or a grouping says.
    fn learn(&mut self, env: &mut dyn VectorEnv) -> Result<Turn, CoversError>;

    /// Finds the policy for what `env` runs from the first frames of this many episodes, or,
    /// without a number, of as many as it needs; learns nothing.
    ///
    /// All draws come from `rng`, so that looking does not change what is learnt next.
    ///
    /// # Errors
    /// What the environment, a policy or a grouping says.
    fn recognise(
        &mut self,
        env: &mut dyn VectorEnv,
        episodes: Option<usize>,
        rng: &mut ChaCha8Rng,
    ) -> Result<Recognised, CoversError>;

    /// Runs `rounds` episodes in every environment with the mean actions of policy `index`; learns
    /// nothing.
    ///
    /// # Errors
    /// [`CoversError::Setting`] for a policy that does not exist, or what the environment says.
    fn perform(
        &mut self,
        index: usize,
        env: &mut dyn VectorEnv,
        rounds: usize,
    ) -> Result<Performance, CoversError>;

    /// All numbers of policy `index` that [`Learner::perform`] depends on, so that a policy which
    /// is the same need not perform the same again. None where a learner does not say.
    fn parameters(&self, _index: usize) -> Option<&[f32]> {
        None
    }

    /// Policy `index` in ordinary layers, and what it says of `observations`.
    ///
    /// # Errors
    /// [`CoversError::Setting`] for a policy that does not exist, [`rl::RlError::NotPlain`] for one
    /// that other programs have no layers for, [`CoversError::Unexportable`] for learners that
    /// write none.
    fn export(
        &mut self,
        _index: usize,
        _observations: &Observations,
    ) -> Result<(PlainPolicy, Answers), CoversError> {
        Err(CoversError::Unexportable)
    }

    /// The number of policies, at least 1.
    fn policies(&self) -> usize;

    /// The bytes of a file that holds the learner and a note of the caller's; equal learners give
    /// equal bytes. `path` is where they will be written, for errors to name.
    ///
    /// # Errors
    /// [`CoversError::NotFinite`] for a learner with a number that is not finite;
    /// [`CoversError::Setting`] for an extent of too few episodes.
    fn encode(&self, path: &Path, extent: Extent, note: &str) -> Result<Vec<u8>, CoversError>;

    /// Writes that file. It appears whole or not at all, also after a power cut;
    /// [`LearnerSettings::load`](super::LearnerSettings::load) reads it.
    ///
    /// # Errors
    /// As [`encode`](Learner::encode), and [`CoversError::Write`].
    fn save(&self, path: &Path, extent: Extent, note: &str) -> Result<(), CoversError> {
        replace(&LocalDisk, path, &self.encode(path, extent, note)?)
    }
}

/// What one call of [`Learner::perform`] showed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Performance {
    /// Returns and successes of the episodes.
    pub stats: RolloutStats,
    /// What the units of the policy's network put out along the way; none seen where a learner has
    /// no such units.
    pub activity: Activity,
}

/// What one call of [`Learner::learn`] did.
#[derive(Clone, Debug)]
pub struct Turn {
    /// Index of the policy that learnt.
    pub policy: usize,
    /// Whether that policy was created in this turn.
    pub created: bool,
    /// Evidence of the grouping, one item for each policy that was compared; empty for learners and
    /// groupings that compare nothing.
    pub evidence: Vec<Evidence>,
    /// Evidence of the first look, where it left the grouping undecided and one more rollout was
    /// collected: `evidence` is that of both.
    pub first_look: Option<Vec<Evidence>>,
    /// For each policy the one that acts for its group since the two were merged; empty for
    /// learners and groupings that merge no policies.
    pub heirs: Vec<Option<usize>>,
    /// Decisions taken, discarded ones included.
    pub decisions: usize,
    /// Returns and successes of the rollout that was learnt from.
    pub rollout: RolloutStats,
    /// What the learner logs, by name; the same names in every turn.
    pub metrics: Metrics,
    /// Where the time went.
    pub seconds: Seconds,
}

/// Wall-clock seconds of the parts of a turn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seconds {
    /// Rollouts: the environments and the policy's decisions.
    pub collection: f64,
    /// The grouping: features, distances and permutations.
    pub assignment: f64,
    /// The policy update.
    pub update: f64,
}

/// How much of a learner is saved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// All of it: the copy learns on to the same bits.
    Everything,
    /// What acting and recognising take: policies, and the first frames of at most this many
    /// episodes each. A copy that learns on starts with fresh optimisers.
    Policies {
        /// Episodes a policy, at least as many as the grouping needs to recognise a group.
        episodes: usize,
    },
}
