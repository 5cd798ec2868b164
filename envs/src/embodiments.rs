//! Embodiments of this crate: the gripper alone, and arms.

mod arm;
mod file_arm;
mod kinova_gen3;
mod lazy_arm;
mod placing;

use glam::DVec3;

use crate::actuation::NamedJointPositions;
use crate::embodiment_spec::{EmbodimentSceneParts, EmbodimentSpec};
use crate::error::EnvError;
use crate::mjcf::{Mjcf, part, parts};

pub use arm::{Arm, ArmSettings, Finger, FingerJoint, Gripper};
pub(crate) use kinova_gen3::KINOVA_GEN3;
pub use kinova_gen3::KinovaGen3;
pub(crate) use lazy_arm::LazyArm;

/// Finger slides and actuators of `Sawyer` and `FloatingHand`.
const GRIPPER: Mjcf<'static> = part!("gripper.xml");

fn parts(mjcf: &'static str, included_files: &[Mjcf<'static>]) -> EmbodimentSceneParts {
    let files = included_files.iter().chain([&GRIPPER]);
    EmbodimentSceneParts {
        mjcf: mjcf.into(),
        included_files: files.map(|&(name, text)| (name, text.into())).collect(),
    }
}

/// Gripper alone on three slides; it moves like the Sawyer arm's hand and is exactly symmetric.
#[derive(Clone, Copy, Debug)]
pub struct FloatingHand;

impl EmbodimentSpec for FloatingHand {
    fn name(&self) -> &str {
        "hand"
    }

    fn parts(&self) -> Result<EmbodimentSceneParts, EnvError> {
        let included = parts!(["block.xml", "contacts.xml", "drawer_stop.xml", "peg_contacts.xml", "puck.xml"] in "hand");
        Ok(parts(part!("hand.xml").1, &included))
    }

    fn initial_joint_positions(&self, hand_target: DVec3) -> Result<NamedJointPositions, EnvError> {
        let slides = ["hand_x", "hand_y", "hand_z"].map(String::from);
        Ok(slides.into_iter().zip(hand_target.to_array()).collect())
    }

    fn mirrors_exactly(&self) -> bool {
        true
    }
}

/// Seven-joint Sawyer arm. Open loop, it breaks the symmetry of the table by one or two
/// centimetres.
#[derive(Clone, Copy, Debug)]
pub struct Sawyer;

/// Initial joint positions (radians) of the Sawyer arm, with the hand almost at rest at
/// [`HAND_TARGET_START`](crate::HAND_TARGET_START).
const REST: [(&str, f64); 7] = [
    ("j0", 1.932580),
    ("j1", -0.499083),
    ("j2", -1.058834),
    ("j3", 1.651000),
    ("j4", 1.047360),
    ("j5", 1.084860),
    ("j6", 2.292554),
];

impl EmbodimentSpec for Sawyer {
    fn name(&self) -> &str {
        "sawyer"
    }

    fn parts(&self) -> Result<EmbodimentSceneParts, EnvError> {
        let included = parts!(["block.xml", "contacts.xml", "drawer_stop.xml", "peg_contacts.xml", "puck.xml"] in "sawyer");
        Ok(parts(part!("sawyer.xml").1, &included))
    }

    /// Returns the positions for [`HAND_TARGET_START`](crate::HAND_TARGET_START), whatever the
    /// target: the weld pulls the arm from there.
    fn initial_joint_positions(&self, _: DVec3) -> Result<NamedJointPositions, EnvError> {
        Ok(REST.iter().map(|&(name, at)| (name.to_owned(), at)).collect())
    }

    fn meta_world_mjcf(&self) -> Option<&str> {
        Some(part!("sawyer.xml" in "metaworld").1)
    }
}
