//! What carries the gripper: its part of the scene and the posture that it settles from.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::error::EnvError;
use crate::mjcf::{Mjcf, part, parts};

const SAWYER: Mjcf<'static> = part!("sawyer.xml");
const HAND: Mjcf<'static> = part!("hand.xml");
const OF_SAWYER: [Mjcf<'static>; 3] =
    parts!(["contacts.xml", "drawer_stop.xml", "puck.xml"] in "sawyer");
const OF_HAND: [Mjcf<'static>; 3] =
    parts!(["contacts.xml", "drawer_stop.xml", "puck.xml"] in "hand");

/// Joint positions (radians) near the arm's rest with the hand at
/// [`HAND_START`](crate::HAND_START).
const SAWYER_POSTURE: [(&str, f64); 7] = [
    ("j0", 1.932580),
    ("j1", -0.499083),
    ("j2", -1.058834),
    ("j3", 1.651000),
    ("j4", 1.047360),
    ("j5", 1.084860),
    ("j6", 2.292554),
];

/// What carries the gripper.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Embodiment {
    /// A seven-joint Sawyer arm, which breaks the symmetry of the table by a centimetre or two open
    /// loop.
    #[default]
    Sawyer,
    /// The gripper alone on three slides; moves like the arm's hand and mirrors exactly.
    Hand,
}

impl Embodiment {
    /// Every embodiment, in the order of reports.
    pub const ALL: [Self; 2] = [Self::Sawyer, Self::Hand];

    /// The name as options spell it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sawyer => "sawyer",
            Self::Hand => "hand",
        }
    }

    /// Whether the four variants of a group move as exact mirror images of one another.
    pub fn mirrors_exactly(self) -> bool {
        self == Self::Hand
    }

    pub(crate) fn mjcf(self) -> Mjcf<'static> {
        match self {
            Self::Sawyer => SAWYER,
            Self::Hand => HAND,
        }
    }

    /// Files that other parts include by name: what collides with what, and what of the puck does.
    pub(crate) fn included(self) -> &'static [Mjcf<'static>] {
        match self {
            Self::Sawyer => &OF_SAWYER,
            Self::Hand => &OF_HAND,
        }
    }

    /// Joints and positions near rest with the hand's target at `hand_target`, which for the arm is
    /// [`HAND_START`](crate::HAND_START).
    pub(crate) fn posture(self, hand_target: DVec3) -> Vec<(&'static str, f64)> {
        match self {
            Self::Sawyer => SAWYER_POSTURE.to_vec(),
            Self::Hand => ["hand_x", "hand_y", "hand_z"]
                .into_iter()
                .zip(hand_target.to_array())
                .collect(),
        }
    }
}

impl std::fmt::Display for Embodiment {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for Embodiment {
    type Err = EnvError;

    fn from_str(name: &str) -> Result<Self, EnvError> {
        Self::ALL
            .into_iter()
            .find(|embodiment| embodiment.name() == name)
            .ok_or_else(|| EnvError::UnknownEmbodiment {
                name: name.to_owned(),
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_parse_back_and_unknown_ones_list_the_choices() {
        for embodiment in Embodiment::ALL {
            assert_eq!(embodiment.name().parse::<Embodiment>().unwrap(), embodiment);
        }
        let message = "spot".parse::<Embodiment>().unwrap_err().to_string();
        assert!(message.contains("spot") && message.contains("sawyer or hand"));
    }
}
