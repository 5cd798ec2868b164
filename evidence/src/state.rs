//! The memory of a recogniser as a value that a file can hold.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::error::EvidenceError;
use crate::memory::{Memory, check, check_heirs, known};
use crate::recogniser::Recogniser;

/// Version that is written, and the only one that is read.
const VERSION: u32 = 2;

#[derive(Serialize)]
struct Saved<'a> {
    format: u32,
    policies: &'a [Memory],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct State {
    #[serde(rename = "format", deserialize_with = "version")]
    _format: (),
    policies: Vec<Memory>,
}

/// Refuses another version before the policies are read, whose fields may be others.
fn version<'de, D: Deserializer<'de>>(deserializer: D) -> Result<(), D::Error> {
    let (got, expected) = (u32::deserialize(deserializer)?, VERSION);
    if got == expected {
        return Ok(());
    }
    Err(D::Error::custom(EvidenceError::StateVersion { got, expected }))
}

impl Recogniser {
    /// The state as a value that [`Recogniser::restore`] takes.
    ///
    /// # Errors
    /// A serialiser's.
    pub fn state<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (format, policies) = (VERSION, &self.memories[..]);
        Saved { format, policies }.serialize(serializer)
    }

    /// Takes a state back.
    ///
    /// # Errors
    /// A deserialiser's, a state of another version or with unknown fields, numbers that are not
    /// finite, lists of other lengths, named policies that are none, heirs in a circle, or a policy
    /// without accounts or with more than `memory`. Nothing is taken back then.
    pub fn restore<'de, D: Deserializer<'de>>(&mut self, state: D) -> Result<(), D::Error> {
        let memories = State::deserialize(state)?.policies;
        let (most, policies) = (self.settings().memory, memories.len());
        let mut checks = memories.iter().map(|memory| memory.check(most, policies));
        let checked = checks.try_for_each(|check| check);
        checked
            .and_then(|()| check_heirs(&memories))
            .and_then(|()| check(known(&memories)))
            .map_err(D::Error::custom)?;
        self.memories = memories;
        Ok(())
    }
}
