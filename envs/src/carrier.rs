//! What an embodiment says about itself.

use std::any::Any;
use std::borrow::Cow;

use glam::DVec3;

use crate::drive::{Drive, Posture};
use crate::error::EnvError;

/// Claw distance of an open gripper (metres).
pub(crate) const OPEN_APERTURE: f64 = 0.1;

/// What a scene is made of, as far as the embodiment decides it.
#[derive(Clone, Debug, PartialEq)]
pub struct CarrierParts {
    /// The embodiment's part of the scene, a `<mujocoinclude>`.
    ///
    /// It needs the bodies `hand`, `right_claw` and `left_claw`, and the sites `right_tip` and
    /// `left_tip`. The claws are 0.1 m apart where the gripper is open, and the tips 0.045 m below
    /// the hand: scripted experts count on both. Geoms are in group 3, which learners do not see.
    /// Everything has a name, and none is `object`, `goal` or a name of the arena.
    pub mjcf: Cow<'static, str>,
    /// Files that the parts of a scene include by name, and their texts. `contacts.xml` declares
    /// the classes `surroundings` and `table_contact` and what collides by default,
    /// `drawer_stop.xml` stops a shut drawer, and `puck.xml` says what of the puck collides.
    pub included: Vec<(&'static str, Cow<'static, str>)>,
}

/// What carries the gripper. It keeps no state between calls.
pub trait Carrier: Any + Send + Sync {
    /// The name as settings and files spell it: lower-case letters and digits in words that are
    /// joined by hyphens or underscores.
    fn name(&self) -> &str;

    /// What the scene gets of it.
    ///
    /// # Errors
    /// Why there is none, for instance a robot that is not described well.
    fn parts(&self) -> Result<CarrierParts, EnvError>;

    /// Joints and positions near rest with the hand's target at `hand_target` (metres, world).
    /// Joints that are left out start at zero.
    ///
    /// # Errors
    /// Why there is none, for instance a place out of reach.
    fn posture(&self, hand_target: DVec3) -> Result<Posture, EnvError>;

    /// How a decision moves it.
    ///
    /// # Errors
    /// As [`Carrier::parts`].
    fn drive(&self) -> Result<Drive, EnvError> {
        Ok(Drive::Weld)
    }

    /// Whether the four variants of a group move as exact mirror images of one another.
    fn mirrors_exactly(&self) -> bool {
        false
    }

    /// Its part of the scene in the layout `metaworld`, where that is another one. It comes from
    /// the model's initial pose then, as Meta-World's own arm does.
    fn stock(&self) -> Option<&str> {
        None
    }
}
