//! Embodiments by name: the handle that settings store, and the registry.

use std::any::Any;
use std::path::Path;
use std::sync::{PoisonError, RwLock};

use robots::{DescriptionError, RobotFile};
use serde::{Deserialize, Deserializer, de};

use crate::embodiment_spec::EmbodimentSpec;
use crate::embodiments::{Arm, FloatingHand, KINOVA_GEN3, LazyArm, Sawyer};
use crate::error::EnvError;
use crate::instance_id::{InstanceId, impl_traits_by_name};

/// Robot or bare gripper that acts in an environment: a handle on the [`EmbodimentSpec`] that
/// defines it.
///
/// Embodiments are compared, ordered, hashed, printed and serialised by name. Settings store the
/// name, so reading them requires an embodiment of this crate, one that the program gave to
/// [`Embodiment::register`], or the file of an arm, whose path is the name
/// ([`Embodiment::from_file`]).
#[derive(Clone, Copy)]
pub struct Embodiment(&'static dyn EmbodimentSpec);

/// Embodiments that the embedding program has registered.
static REGISTERED: RwLock<Vec<Embodiment>> = RwLock::new(Vec::new());

impl Embodiment {
    /// Seven-joint Sawyer arm. Open loop, it breaks the symmetry of the table by one or two
    /// centimetres.
    pub const SAWYER: Self = Self::from_spec(&Sawyer);
    /// Gripper alone on three slides; it moves like the Sawyer arm's hand and is exactly symmetric.
    pub const FLOATING_HAND: Self = Self::from_spec(&FloatingHand);
    /// Kinova Gen3 with a Robotiq gripper under Cartesian control.
    pub const KINOVA_GEN3: Self = Self::from_spec(&KINOVA_GEN3);

    /// Embodiments for training, in the order in which reports list them. Every task must pass its
    /// conformance rules with them.
    pub const STANDARD: [Self; 2] = [Self::SAWYER, Self::FLOATING_HAND];
    /// Embodiments that this crate provides.
    pub const BUILT_IN: [Self; 3] = [Self::SAWYER, Self::FLOATING_HAND, Self::KINOVA_GEN3];

    /// Returns the handle of the embodiment that `spec` defines.
    ///
    /// A spec that is made at run time must be leaked, as with
    /// [`TaskGroup::from_task`](crate::TaskGroup::from_task):
    /// `Embodiment::from_spec(Box::leak(Box::new(spec)))`.
    pub const fn from_spec(spec: &'static dyn EmbodimentSpec) -> Self {
        Self(spec)
    }

    /// Returns the embodiment of the arm that the file `path` describes, a URDF or the JSON of a
    /// [`RobotFile`], which is read when a scene first needs the arm. Its name is the absolute
    /// path.
    ///
    /// # Errors
    /// [`EnvError::InvalidEmbodimentName`] for a path that is not UTF-8 or has another extension;
    /// [`EnvError::Robot`] for an empty path, or without a working directory.
    pub fn from_file(path: &Path) -> Result<Self, EnvError> {
        let absolute = std::path::absolute(path)
            .map_err(|source| DescriptionError::Read { path: path.to_owned(), source })?;
        let text = absolute.to_str().filter(|_| RobotFile::has_supported_extension(path));
        let Some(name) = text else {
            let name = path.display().to_string();
            return Err(EnvError::InvalidEmbodimentName { name });
        };
        let mut registered = REGISTERED.write().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = registered.iter().find(|known| known.name() == name) {
            return Ok(*known);
        }
        let lazy = LazyArm::new(name.to_owned().into(), |file| {
            Arm::from_file(file, &RobotFile::read(Path::new(file))?)
        });
        let arm = Self::from_spec(Box::leak(Box::new(lazy)));
        registered.push(arm);
        Ok(arm)
    }

    /// Returns the robot arm of an embodiment with servos; an error for any other, such as
    /// [`Embodiment::SAWYER`].
    ///
    /// # Errors
    /// [`EnvError::InvalidSetting`] for an embodiment without servos; errors of reading the file of
    /// an arm.
    pub fn arm(self) -> Result<&'static Arm, EnvError> {
        let spec: &'static dyn Any = self.0;
        if let Some(lazy) = spec.downcast_ref::<LazyArm>() {
            return lazy.arm();
        }
        spec.downcast_ref::<Arm>().ok_or_else(|| EnvError::InvalidSetting {
            name: "embodiment",
            value: self.name().to_owned(),
            expected: "an arm with servos: kinova_gen3, or the URDF of an arm",
        })
    }

    /// Returns the embodiment's name as settings and files spell it, for instance `sawyer`.
    pub fn name(self) -> &'static str {
        self.0.name()
    }

    /// Returns the specification that defines the embodiment.
    pub fn spec(self) -> &'static dyn EmbodimentSpec {
        self.0
    }

    /// Registers the embodiment's name in this process, so that settings with it can be read.
    /// Registering an embodiment again has no effect.
    ///
    /// # Errors
    /// [`EnvError::InvalidEmbodimentName`] for a malformed name, [`EnvError::DuplicateEmbodiment`]
    /// for a name that is taken.
    pub fn register(self) -> Result<(), EnvError> {
        self.check_name()?;
        let mut registered = REGISTERED.write().unwrap_or_else(PoisonError::into_inner);
        let mut known = Self::BUILT_IN.iter().chain(registered.iter());
        match known.find(|known| **known == self) {
            // the very same definition again, for instance from a second thread
            Some(known) if known.instance_id() == self.instance_id() => {}
            Some(_) => {
                let name = self.name().to_owned();
                return Err(EnvError::DuplicateEmbodiment { name });
            }
            None => registered.push(self),
        }
        Ok(())
    }

    /// Returns the embodiments of this crate, then those that the process has registered or made
    /// from files.
    pub fn all_known() -> Vec<Self> {
        let registered = REGISTERED.read().unwrap_or_else(PoisonError::into_inner);
        [&Self::BUILT_IN, &registered[..]].concat()
    }

    /// Returns `true` if with this embodiment the four variants of a task group move as exact
    /// mirror images of each other.
    pub fn mirrors_exactly(self) -> bool {
        self.0.mirrors_exactly()
    }

    /// Returns an id that distinguishes the embodiment from another one with the same name.
    pub(crate) fn instance_id(self) -> InstanceId {
        InstanceId::of(self.0)
    }

    pub(crate) fn check_name(self) -> Result<(), EnvError> {
        if RobotFile::has_supported_extension(Path::new(self.name())) {
            return Ok(());
        }
        let plain = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit();
        let is_word = |word: &str| !word.is_empty() && word.bytes().all(plain);
        if self.name().split(['-', '_']).all(is_word) {
            return Ok(());
        }
        let name = self.name().to_owned();
        Err(EnvError::InvalidEmbodimentName { name })
    }
}

impl Default for Embodiment {
    /// Returns the Sawyer arm, [`Embodiment::SAWYER`].
    fn default() -> Self {
        Self::SAWYER
    }
}

impl_traits_by_name!(Embodiment);

impl std::str::FromStr for Embodiment {
    type Err = EnvError;

    fn from_str(name: &str) -> Result<Self, EnvError> {
        let known = Self::all_known();
        let found = known.iter().find(|embodiment| embodiment.name() == name);
        if found.is_none() && RobotFile::has_supported_extension(Path::new(name)) {
            return Self::from_file(Path::new(name));
        }
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
    use crate::actuation::NamedJointPositions;
    use crate::embodiment_spec::EmbodimentSceneParts;
    use crate::instance_id::Named;

    impl EmbodimentSpec for Named {
        fn name(&self) -> &str {
            self.0
        }

        fn parts(&self) -> Result<EmbodimentSceneParts, EnvError> {
            unreachable!("the registry asks for the name alone")
        }

        fn initial_joint_positions(&self, _: DVec3) -> Result<NamedJointPositions, EnvError> {
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
        let written = serde_json::to_string(&Embodiment::FLOATING_HAND).unwrap();
        assert_eq!(written, "\"hand\"");
        assert_eq!(
            serde_json::from_str::<Embodiment>(&written).unwrap(),
            Embodiment::FLOATING_HAND
        );
    }

    #[test]
    fn a_registered_name_is_read_and_a_taken_or_malformed_one_refused() {
        let crane = Embodiment::from_spec(&CRANE);
        crane.register().unwrap();
        crane.register().unwrap();
        assert_eq!("crane_2".parse::<Embodiment>().unwrap(), crane);
        assert_eq!(Embodiment::all_known().iter().filter(|&&known| known == crane).count(), 1);
        let message = "spot".parse::<Embodiment>().unwrap_err().to_string();
        assert!(message.contains("crane_2"), "{message}");
        static OTHER: [Named; 3] = [Named("crane_2"), Named("sawyer"), Named("My Arm")];
        for (other, says) in OTHER.iter().zip(["taken", "taken", "`My Arm`"]) {
            let refusal = Embodiment::from_spec(other).register().unwrap_err().to_string();
            assert!(refusal.contains(says), "{refusal}");
        }
    }
}
