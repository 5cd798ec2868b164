//! Definition of an embodiment.

use std::any::Any;
use std::borrow::Cow;

use glam::DVec3;

use crate::actuation::{HandActuation, NamedJointPositions};
use crate::error::EnvError;

/// Distance between the claws of an open gripper (metres).
pub(crate) const OPEN_APERTURE: f64 = 0.1;

/// Parts of a scene that depend on the embodiment.
#[derive(Clone, Debug, PartialEq)]
pub struct EmbodimentSceneParts {
    /// MJCF of the embodiment, a `<mujocoinclude>` document.
    ///
    /// Required are the bodies `hand`, `right_claw` and `left_claw`, and the sites `right_tip` and
    /// `left_tip`. Scripted experts assume that open claws are 0.1 m apart and that the tips are
    /// 0.045 m below the hand. Geoms are in group 3, which learners do not see. Everything has a
    /// name other than `object`, `goal` and the names of the arena.
    pub mjcf: Cow<'static, str>,
    /// Names and texts of the files that parts of a scene include. `contacts.xml` declares the
    /// classes `surroundings` and `table_contact` and the default collisions, `drawer_stop.xml`
    /// stops a closed drawer, and `puck.xml`, `block.xml` and `peg_contacts.xml` declare the
    /// collision shapes of objects that move freely.
    pub included_files: Vec<(&'static str, Cow<'static, str>)>,
}

/// Definition of an embodiment. It keeps no state between calls.
pub trait EmbodimentSpec: Any + Send + Sync {
    /// Returns the embodiment's name as settings and files spell it: words of lower-case letters
    /// and digits, joined by hyphens or underscores.
    fn name(&self) -> &str;

    /// Returns the parts of a scene that depend on the embodiment.
    ///
    /// # Errors
    /// For instance [`EnvError::Robot`] for an invalid robot description.
    fn parts(&self) -> Result<EmbodimentSceneParts, EnvError>;

    /// Returns joint positions at which the embodiment is nearly at rest with the hand's target at
    /// `hand_target` (metres, world frame). Joints that are left out start at zero.
    ///
    /// # Errors
    /// For instance [`EnvError::Control`] for a target out of reach.
    fn initial_joint_positions(&self, hand_target: DVec3) -> Result<NamedJointPositions, EnvError>;

    /// Returns the mechanism by which decisions move the hand.
    ///
    /// # Errors
    /// Errors of [`EmbodimentSpec::parts`].
    fn actuation(&self) -> Result<HandActuation, EnvError> {
        Ok(HandActuation::Weld)
    }

    /// Returns `true` if the four variants of a group move as exact mirror images of each other.
    fn mirrors_exactly(&self) -> bool {
        false
    }

    /// Returns the embodiment's MJCF for the layout `metaworld`, if it differs from that of the
    /// symmetric layout. An episode then starts from the model's initial pose, as with Meta-World's
    /// own arm.
    fn meta_world_mjcf(&self) -> Option<&str> {
        None
    }
}
