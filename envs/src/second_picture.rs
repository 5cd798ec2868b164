//! What an observation shows beside the picture of now.

use serde::{Deserialize, Serialize};

/// The second three of an observation's six channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum SecondPicture {
    /// The episode's first picture.
    #[default]
    First,
    /// The picture of now around the place of the table under the hand, without the gripper's mark:
    /// where objects are relative to the hand. It is cut out of what is drawn, so the table is
    /// [`Camera::oversampling`](crate::Camera::oversampling) times as large as in the whole
    /// picture. What lies beyond is grey.
    CloseUp,
}
