//! What an observation shows beside the picture of now.

use serde::{Deserialize, Serialize};

use super::RGB;

/// The pictures behind that of now in an observation's image, three channels each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Beside {
    /// The episode's first picture.
    #[default]
    First,
    /// The picture of now around the place of the table under the hand, without the gripper's mark:
    /// where objects are relative to the hand. It is cut out of what is drawn, so the table is
    /// [`Camera::oversampling`](crate::Camera::oversampling) times as large as in the whole
    /// picture. What lies beyond is grey.
    CloseUp,
    /// The episode's first picture, then the close-up.
    FirstAndCloseUp,
}

impl Beside {
    /// Channels of an observation's image, C: six or nine.
    pub const fn channels(self) -> usize {
        match self {
            Self::First | Self::CloseUp => 2 * RGB,
            Self::FirstAndCloseUp => 3 * RGB,
        }
    }

    /// How many of the last channels show the same throughout an episode, and need to be kept once:
    /// three or none.
    pub const fn still_channels(self) -> usize {
        match self {
            Self::First => RGB,
            Self::CloseUp | Self::FirstAndCloseUp => 0,
        }
    }
}
