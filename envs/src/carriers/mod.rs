//! The embodiments that come with the crate, one file each.

mod arm;
mod hand;
mod kinova_gen3;
mod sawyer;

pub use arm::{Arm, ArmSettings, Finger, Gripper};
pub use hand::Hand;
pub use kinova_gen3::KinovaGen3;
pub use sawyer::Sawyer;

use crate::carrier::CarrierParts;
use crate::mjcf::Mjcf;

/// How the fingers of Sawyer and hand slide and are driven.
const GRIPPER: Mjcf<'static> = crate::mjcf::part!("gripper.xml");

/// Parts from files of the crate.
fn parts(mjcf: &'static str, included: &[Mjcf<'static>]) -> CarrierParts {
    let files = included.iter().chain([&GRIPPER]);
    CarrierParts {
        mjcf: mjcf.into(),
        included: files.map(|&(name, text)| (name, text.into())).collect(),
    }
}
