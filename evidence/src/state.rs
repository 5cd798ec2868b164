//! Stored state of a recogniser.

use std::collections::VecDeque;

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::error::{EvidenceError, check_finite};
use crate::memory::{PolicyMemory, all_summaries, check_comparable, check_merges};
use crate::recogniser::{Recogniser, UndecidedRollout};

/// Number of the state's format, the only one that is written and read.
const VERSION: u32 = 3;

/// Stored state of a recogniser: the memories of all policies and the undecided rollouts, borrowed
/// or owned.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct State<M, U> {
    #[serde(deserialize_with = "version")]
    format: u32,
    policies: M,
    #[serde(rename = "held")]
    undecided: U,
    #[serde(default)]
    last_trained: Option<usize>,
}

/// Reads the format number and rejects others before the policies are read, whose fields may
/// differ.
fn version<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    let (got, expected) = (u32::deserialize(deserializer)?, VERSION);
    if got == expected {
        return Ok(got);
    }
    Err(D::Error::custom(EvidenceError::StateVersion { got, expected }))
}

impl Recogniser {
    /// Serialises the memories of all policies and the undecided rollouts for
    /// [`Recogniser::restore_state`].
    ///
    /// # Errors
    /// Errors of the serialiser.
    pub fn serialise_state<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (policies, undecided) = (&self.memories, &self.undecided);
        let last_trained = self.last_trained;
        State { format: VERSION, policies, undecided, last_trained }.serialize(serializer)
    }

    /// Replaces the memories of all policies and the undecided rollouts by a stored state.
    ///
    /// # Errors
    /// Errors of the deserialiser, a state of another format or with unknown fields, numbers that
    /// are not finite, lists of different lengths, unknown policy indices, a cycle of merges, a
    /// policy or undecided rollout without episodes or with more than `memory`. Nothing is replaced
    /// then.
    pub fn restore_state<'de, D: Deserializer<'de>>(&mut self, state: D) -> Result<(), D::Error> {
        let state: State<Vec<PolicyMemory>, VecDeque<UndecidedRollout>> =
            State::deserialize(state)?;
        self.check_state(&state).map_err(D::Error::custom)?;
        (self.memories, self.undecided) = (state.policies, state.undecided);
        self.last_trained = state.last_trained;
        Ok(())
    }

    /// Checks that a stored state is consistent: a run could have left it.
    fn check_state(
        &self,
        state: &State<Vec<PolicyMemory>, VecDeque<UndecidedRollout>>,
    ) -> Result<(), EvidenceError> {
        let State { policies: memories, undecided, last_trained, .. } = state;
        let (most, policies) = (self.settings().memory, memories.len());
        let exists = |policy: usize, end: usize| {
            if policy < end { Ok(()) } else { Err(EvidenceError::NoPolicy { policy, policies }) }
        };
        let fits = |got: usize| match got {
            0 => Err(EvidenceError::TooFewEpisodes { got, needed: 1 }),
            _ if got > most => Err(EvidenceError::TooManyEpisodes { got, most }),
            _ => Ok(()),
        };
        for memory in memories {
            let mut named = memory.distinct_from.iter().chain(&memory.merged_into);
            named.try_for_each(|&policy| exists(policy, policies))?;
            fits(memory.summaries.len())?;
            if !memory.after_update.is_empty() {
                fits(memory.after_update.len())?;
            }
            check_finite("initial return", memory.initial_return.unwrap_or(0.0))?;
        }
        last_trained.iter().try_for_each(|&policy| exists(policy, policies))?;
        check_merges(memories)?;
        for rollout in undecided {
            // the next new policy may have acted
            exists(rollout.collector, policies + 1)?;
            fits(rollout.summaries.len())?;
        }
        let kept = undecided.iter().flat_map(|rollout| &rollout.summaries);
        check_comparable(all_summaries(memories).chain(kept))
    }
}
