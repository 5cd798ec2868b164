//! The embodiments that come with the crate, one file each.

mod hand;
mod sawyer;

pub use hand::Hand;
pub use sawyer::Sawyer;

use crate::carrier::CarrierParts;
use crate::mjcf::Mjcf;

/// How the fingers of both slide and are driven.
const GRIPPER: Mjcf<'static> = crate::mjcf::part!("gripper.xml");

/// Parts from files of the crate.
fn parts(mjcf: &'static str, included: &[Mjcf<'static>]) -> CarrierParts<'static> {
    let files = included.iter().chain([&GRIPPER]);
    CarrierParts {
        mjcf: mjcf.into(),
        included: files.map(|&(name, text)| (name, text.into())).collect(),
    }
}
