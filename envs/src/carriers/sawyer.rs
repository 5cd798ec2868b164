//! A Sawyer arm whose hand is welded to its target.

use glam::DVec3;

use super::parts;
use crate::carrier::{Carrier, CarrierParts};
use crate::drive::Posture;
use crate::error::EnvError;
use crate::mjcf::{Mjcf, part, parts};

/// A seven-joint Sawyer arm, which breaks the symmetry of the table by a centimetre or two open
/// loop.
#[derive(Clone, Copy, Debug)]
pub struct Sawyer;

const INCLUDED: [Mjcf<'static>; 3] =
    parts!(["contacts.xml", "drawer_stop.xml", "puck.xml"] in "sawyer");

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
        Ok(parts(part!("sawyer.xml").1, &INCLUDED))
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
