//! The gripper alone.

use glam::DVec3;

use super::parts;
use crate::carrier::{Carrier, CarrierParts};
use crate::drive::Posture;
use crate::error::EnvError;
use crate::mjcf::{Mjcf, part, parts};

/// The gripper alone on three slides; moves like the arm's hand and mirrors exactly.
#[derive(Clone, Copy, Debug)]
pub struct Hand;

const INCLUDED: [Mjcf<'static>; 3] =
    parts!(["contacts.xml", "drawer_stop.xml", "puck.xml"] in "hand");

impl Carrier for Hand {
    fn name(&self) -> &str {
        "hand"
    }

    fn parts(&self) -> Result<CarrierParts, EnvError> {
        Ok(parts(part!("hand.xml").1, &INCLUDED))
    }

    fn posture(&self, hand_target: DVec3) -> Result<Posture, EnvError> {
        let slides = ["hand_x", "hand_y", "hand_z"].map(String::from);
        Ok(slides.into_iter().zip(hand_target.to_array()).collect())
    }

    fn mirrors_exactly(&self) -> bool {
        true
    }
}
