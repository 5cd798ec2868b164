//! Stored state of a recogniser.

use std::collections::VecDeque;

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::error::EvidenceError;
use crate::memory::{Memory, check, check_heirs, finite, known};
use crate::recogniser::{Held, Recogniser};

/// Number of the state's format, the only one that is written and read.
const VERSION: u32 = 3;

/// Stored state of a recogniser: the memories of all policies and the undecided rollouts, borrowed
/// or owned.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct State<M, H> {
    #[serde(deserialize_with = "version")]
    format: u32,
    policies: M,
    held: H,
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
    /// [`Recogniser::restore`].
    ///
    /// # Errors
    /// Errors of the serialiser.
    pub fn state<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (policies, held) = (&self.memories, &self.held);
        State { format: VERSION, policies, held }.serialize(serializer)
    }

    /// Replaces the memories of all policies and the undecided rollouts by a stored state.
    ///
    /// # Errors
    /// Errors of the deserialiser, a state of another format or with unknown fields, numbers that
    /// are not finite, lists of different lengths, unknown policy indices, merges in a circle, a
    /// policy or held rollout without episodes or with more than `memory`. Nothing is replaced
    /// then.
    pub fn restore<'de, D: Deserializer<'de>>(&mut self, state: D) -> Result<(), D::Error> {
        let state: State<Vec<Memory>, VecDeque<Held>> = State::deserialize(state)?;
        let (memories, held) = (state.policies, state.held);
        self.check_state(&memories, &held).map_err(D::Error::custom)?;
        (self.memories, self.held) = (memories, held);
        Ok(())
    }

    /// Checks that a stored state is consistent: a run could have left it.
    fn check_state(&self, memories: &[Memory], held: &VecDeque<Held>) -> Result<(), EvidenceError> {
        let (most, policies) = (self.settings().memory, memories.len());
        let exists = |policy: usize, end: usize| {
            if policy < end { Ok(()) } else { Err(EvidenceError::NoPolicy { policy, policies }) }
        };
        let fits = |got: usize| match got {
            0 => Err(EvidenceError::TooFewEpisodes { got, needed: 1 }),
            _ if got > most => Err(EvidenceError::TooManyAccounts { got, most }),
            _ => Ok(()),
        };
        for memory in memories {
            let mut named = memory.apart.iter().chain(&memory.heir);
            named.try_for_each(|&policy| exists(policy, policies))?;
            fits(memory.accounts.len())?;
            finite("beginning", memory.beginning.unwrap_or(0.0))?;
        }
        check_heirs(memories)?;
        for rollout in held {
            // the next new policy may have acted
            exists(rollout.collector, policies + 1)?;
            fits(rollout.accounts.len())?;
        }
        check(known(memories).chain(held.iter().flat_map(|rollout| &rollout.accounts)))
    }
}
