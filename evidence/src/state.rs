//! What a recogniser remembers, as a value that a file can hold.

use std::fmt;

use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::error::EvidenceError;
use crate::memory::{Memory, check, check_heirs, known};
use crate::recogniser::Recogniser;

/// The version that is written, and the only one that is read. The first one, a list that names no
/// version, knows neither which way paid nor who has an heir.
const VERSION: u32 = 2;

/// What is written.
#[derive(Serialize)]
struct Saved<'a> {
    format: u32,
    policies: &'a [Memory],
}

/// What is read.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct State {
    #[serde(rename = "format")]
    _format: Version,
    policies: Vec<Memory>,
}

/// The version that can be read.
struct Version;

impl<'de> Deserialize<'de> for Version {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match u32::deserialize(deserializer)? {
            VERSION => Ok(Self),
            got => Err(other(got)),
        }
    }
}

fn other<E: Error>(got: u32) -> E {
    let expected = VERSION;
    E::custom(EvidenceError::StateVersion { got, expected })
}

/// Reads a state of any version, to refuse others by name.
struct AnyState;

impl<'de> Visitor<'de> for AnyState {
    type Value = State;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("what a recogniser remembers of its policies")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, _: A) -> Result<State, A::Error> {
        Err(other(1))
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<State, A::Error> {
        State::deserialize(MapAccessDeserializer::new(map))
    }
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
        let memories = state.deserialize_any(AnyState)?.policies;
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
