//! The handle by which the rest of the crate knows what carries the gripper, and the names.

use std::sync::{PoisonError, RwLock};

use serde::{Deserialize, Deserializer, de};

use crate::carrier::Carrier;
use crate::carriers::{Hand, KinovaGen3, Sawyer};
use crate::error::EnvError;
use crate::identity::{Identity, stands_for_its_name};

/// What carries the gripper: a handle on the [`Carrier`] that defines it.
///
/// Embodiments are compared, ordered, hashed, printed and serialised by their names. Settings hold
/// one by name, so reading them knows the embodiments that come with the crate, and those that the
/// program has given to [`Embodiment::register`].
#[derive(Clone, Copy)]
pub struct Embodiment(&'static dyn Carrier);

/// Those that a program has added.
static REGISTERED: RwLock<Vec<Embodiment>> = RwLock::new(Vec::new());

impl Embodiment {
    /// A seven-joint Sawyer arm, which breaks the symmetry of the table by a centimetre or two open
    /// loop.
    pub const SAWYER: Self = Self::of(&Sawyer);
    /// The gripper alone on three slides; moves like the arm's hand and mirrors exactly.
    pub const HAND: Self = Self::of(&Hand);
    /// A Kinova Gen3 with a Robotiq gripper under Cartesian control, for policies that have learnt
    /// with another arm.
    pub const KINOVA_GEN3: Self = Self::of(&KinovaGen3);

    /// Those that learners learn with, in the order of reports. Every task is held to its rules
    /// with them.
    pub const STANDARD: [Self; 2] = [Self::SAWYER, Self::HAND];
    /// Those that come with the crate.
    pub const BUILT_IN: [Self; 3] = [Self::SAWYER, Self::HAND, Self::KINOVA_GEN3];

    /// The embodiment that `carrier` defines.
    ///
    /// As with [`TaskGroup::of`](crate::TaskGroup::of), one that is made while the program runs is
    /// leaked: `Embodiment::of(Box::leak(Box::new(carrier)))`.
    pub const fn of(carrier: &'static dyn Carrier) -> Self {
        Self(carrier)
    }

    /// The name as settings and files spell it, for instance `sawyer`.
    pub fn name(self) -> &'static str {
        self.0.name()
    }

    /// What defines it.
    pub fn carrier(self) -> &'static dyn Carrier {
        self.0
    }

    /// Makes the name known to this process, so that settings which hold it can be read. To
    /// register an embodiment again changes nothing.
    ///
    /// # Errors
    /// [`EnvError::EmbodimentName`] for a name that settings cannot spell,
    /// [`EnvError::DuplicateEmbodiment`] for one that is taken.
    pub fn register(self) -> Result<(), EnvError> {
        self.check_name()?;
        let mut registered = REGISTERED.write().unwrap_or_else(PoisonError::into_inner);
        let mut known = Self::BUILT_IN.iter().chain(registered.iter());
        match known.find(|known| **known == self) {
            Some(known) if known.identity() == self.identity() => {}
            Some(_) => {
                let name = self.name().to_owned();
                return Err(EnvError::DuplicateEmbodiment { name });
            }
            None => registered.push(self),
        }
        Ok(())
    }

    /// Those that come with the crate, then the registered ones.
    pub fn known() -> Vec<Self> {
        let registered = REGISTERED.read().unwrap_or_else(PoisonError::into_inner);
        [&Self::BUILT_IN, &registered[..]].concat()
    }

    /// Whether the four variants of a group move as exact mirror images of one another.
    pub fn mirrors_exactly(self) -> bool {
        self.0.mirrors_exactly()
    }

    /// What tells it from another one of its name.
    pub(crate) fn identity(self) -> Identity {
        Identity::of(self.0)
    }

    pub(crate) fn check_name(self) -> Result<(), EnvError> {
        let plain = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit();
        let is_word = |word: &str| !word.is_empty() && word.bytes().all(plain);
        if self.name().split(['-', '_']).all(is_word) {
            return Ok(());
        }
        let name = self.name().to_owned();
        Err(EnvError::EmbodimentName { name })
    }
}

impl Default for Embodiment {
    /// [`Embodiment::SAWYER`].
    fn default() -> Self {
        Self::SAWYER
    }
}

stands_for_its_name!(Embodiment);

impl std::str::FromStr for Embodiment {
    type Err = EnvError;

    fn from_str(name: &str) -> Result<Self, EnvError> {
        let known = Self::known();
        let found = known.iter().find(|embodiment| embodiment.name() == name);
        found.copied().ok_or_else(|| EnvError::UnknownEmbodiment {
            name: name.to_owned(),
            known: known.iter().map(|embodiment| embodiment.name()).collect(),
        })
    }
}

impl<'de> Deserialize<'de> for Embodiment {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        name.parse().map_err(de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::carrier::CarrierParts;
    use crate::drive::Posture;
    use crate::identity::Named;

    impl Carrier for Named {
        fn name(&self) -> &str {
            self.0
        }

        fn parts(&self) -> Result<CarrierParts, EnvError> {
            unreachable!("the registry asks for the name alone")
        }

        fn posture(&self, _: DVec3) -> Result<Posture, EnvError> {
            unreachable!("the registry asks for the name alone")
        }
    }

    static CRANE: Named = Named("crane_2");

    #[test]
    fn names_parse_back_and_unknown_ones_list_the_choices() {
        for embodiment in Embodiment::BUILT_IN {
            assert_eq!(embodiment.name().parse::<Embodiment>().unwrap(), embodiment);
        }
        let message = "spot".parse::<Embodiment>().unwrap_err().to_string();
        assert!(message.contains("`spot`") && message.contains("sawyer, hand"));
        let read: Result<Embodiment, _> = serde_json::from_str("\"spot\"");
        assert!(read.unwrap_err().to_string().contains("sawyer, hand"));
        let written = serde_json::to_string(&Embodiment::HAND).unwrap();
        assert_eq!(written, "\"hand\"");
        assert_eq!(serde_json::from_str::<Embodiment>(&written).unwrap(), Embodiment::HAND);
    }

    #[test]
    fn a_registered_name_is_read_and_a_taken_or_malformed_one_refused() {
        let crane = Embodiment::of(&CRANE);
        crane.register().unwrap();
        crane.register().unwrap();
        assert_eq!("crane_2".parse::<Embodiment>().unwrap(), crane);
        assert_eq!(Embodiment::known().iter().filter(|&&known| known == crane).count(), 1);
        let message = "spot".parse::<Embodiment>().unwrap_err().to_string();
        assert!(message.contains("crane_2"), "{message}");
        static OTHER: [Named; 3] = [Named("crane_2"), Named("sawyer"), Named("My Arm")];
        for (other, says) in OTHER.iter().zip(["taken", "taken", "`My Arm`"]) {
            let message = Embodiment::of(other).register().unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
    }
}
