//! Stored state of a recogniser.

use std::collections::VecDeque;

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::error::EvidenceError;
use crate::memory::{Memory, check, check_heirs, known};
use crate::recogniser::{Held, Recogniser};

/// Format that is written, and the only one that is read.
const VERSION: u32 = 3;

#[derive(Serialize)]
struct Saved<'a> {
    format: u32,
    policies: &'a [Memory],
    held: &'a VecDeque<Held>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct State {
    #[serde(rename = "format", deserialize_with = "version")]
    _format: (),
    policies: Vec<Memory>,
    held: VecDeque<Held>,
}

/// Rejects another format before the policies are read, whose fields may differ.
fn version<'de, D: Deserializer<'de>>(deserializer: D) -> Result<(), D::Error> {
    let (got, expected) = (u32::deserialize(deserializer)?, VERSION);
    if got == expected {
        return Ok(());
    }
    Err(D::Error::custom(EvidenceError::StateVersion { got, expected }))
}

impl Recogniser {
    /// Serialises the memories of all policies and the held rollouts for [`Recogniser::restore`].
    ///
    /// # Errors
    /// Errors of the serialiser.
    pub fn state<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (format, policies, held) = (VERSION, &self.memories[..], &self.held);
        Saved { format, policies, held }.serialize(serializer)
    }

    /// Replaces the memories of all policies and the held rollouts by a stored state.
    ///
    /// # Errors
    /// Errors of the deserialiser, a state of another format or with unknown fields, numbers that
    /// are not finite, lists of different lengths, unknown policy indices, merges in a circle, a
    /// policy or held rollout without episodes or with more than `memory`. Nothing is replaced then.
    pub fn restore<'de, D: Deserializer<'de>>(&mut self, state: D) -> Result<(), D::Error> {
        let State { policies: memories, held, .. } = State::deserialize(state)?;
        let (most, policies) = (self.settings().memory, memories.len());
        let mut checks = memories.iter().map(|memory| memory.check(most, policies));
        let checked = checks.try_for_each(|check| check);
        let held_checks = || held.iter().try_for_each(|held| held.check(most, policies));
        checked
            .and_then(|()| check_heirs(&memories))
            .and_then(|()| held_checks())
            .and_then(|()| check(known(&memories).chain(held.iter().flat_map(|h| &h.accounts))))
            .map_err(D::Error::custom)?;
        (self.memories, self.held) = (memories, held);
        Ok(())
    }
}
