//! The embodiments that come with the crate: the gripper alone, and arms.

mod arm;
mod kinova_gen3;

use glam::DVec3;

use crate::carrier::{Carrier, CarrierParts};
use crate::drive::Posture;
use crate::error::EnvError;
use crate::mjcf::{Mjcf, part, parts};

pub use arm::{Arm, ArmSettings, Finger, Gripper};
pub use kinova_gen3::KinovaGen3;

/// How the fingers of Sawyer and hand slide and are driven.
const GRIPPER: Mjcf<'static> = part!("gripper.xml");

/// Parts from files of the crate.
fn parts(mjcf: &'static str, included: &[Mjcf<'static>]) -> CarrierParts {
    let files = included.iter().chain([&GRIPPER]);
    CarrierParts {
        mjcf: mjcf.into(),
        included: files.map(|&(name, text)| (name, text.into())).collect(),
    }
}

/// The gripper alone on three slides; moves like the arm's hand and mirrors exactly.
#[derive(Clone, Copy, Debug)]
pub struct Hand;

impl Carrier for Hand {
    fn name(&self) -> &str {
        "hand"
    }

    fn parts(&self) -> Result<CarrierParts, EnvError> {
        let included = parts!(["contacts.xml", "drawer_stop.xml", "puck.xml"] in "hand");
        Ok(parts(part!("hand.xml").1, &included))
    }

    fn posture(&self, hand_target: DVec3) -> Result<Posture, EnvError> {
        let slides = ["hand_x", "hand_y", "hand_z"].map(String::from);
        Ok(slides.into_iter().zip(hand_target.to_array()).collect())
    }

    fn mirrors_exactly(&self) -> bool {
        true
    }
}

/// A seven-joint Sawyer arm, which breaks the symmetry of the table by a centimetre or two open
/// loop.
#[derive(Clone, Copy, Debug)]
pub struct Sawyer;

/// Joint positions (radians) near the arm's rest with the hand at
/// [`HAND_START`](crate::HAND_START).
const POSTURE: [(&str, f64); 7] = [
    ("j0", 1.932580),
    ("j1", -0.499083),
    ("j2", -1.058834),
    ("j3", 1.651000),
    ("j4", 1.047360),
    ("j5", 1.084860),
    ("j6", 2.292554),
];

impl Carrier for Sawyer {
    fn name(&self) -> &str {
        "sawyer"
    }

    fn parts(&self) -> Result<CarrierParts, EnvError> {
        let included = parts!(["contacts.xml", "drawer_stop.xml", "puck.xml"] in "sawyer");
        Ok(parts(part!("sawyer.xml").1, &included))
    }

    /// Of [`HAND_START`](crate::HAND_START), wherever the target is.
    fn posture(&self, _: DVec3) -> Result<Posture, EnvError> {
        let joints = POSTURE.iter();
        Ok(joints.map(|&(name, at)| (name.to_owned(), at)).collect())
    }

    fn stock(&self) -> Option<&str> {
        Some(part!("sawyer.xml" in "metaworld").1)
    }
}
