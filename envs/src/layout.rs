//! Two layouts of the same tasks: the symmetric one to learn on, and Meta-World's own figures to
//! compare with.

use glam::DVec3;
use serde::{Deserialize, Serialize};
use symmetry::D2;

use crate::carrier::Carrier;
use crate::control::Control;
use crate::drive::Posture;
use crate::error::EnvError;
use crate::mjcf::{Mjcf, parts};
use crate::task::{Stock, TaskGroup};

/// Where the hand's target stands at the start of every episode of the symmetric layout (metres):
/// over the centre, clear of an open drawer.
pub const HAND_START: DVec3 = DVec3::new(0.0, 0.0, 0.22);

const SYMMETRIC: [Mjcf<'static>; 4] =
    parts!(["left_finger.xml", "plunger.xml", "handle.xml", "bars.xml"] in "symmetric");
const META_WORLD: [Mjcf<'static>; 4] =
    parts!(["left_finger.xml", "plunger.xml", "handle.xml", "bars.xml"] in "metaworld");

/// Physics steps until a hand is at rest at its start: 10 s.
const SETTLED: usize = 4000;
/// Physics steps of Meta-World's reset: 0.625 s, after which its arm still moves.
const STOCK_RESET: usize = 250;

/// How a scene comes to where its episodes start.
pub(crate) struct Settling {
    /// Where the hand's target stands (metres).
    pub hand_target: DVec3,
    /// Joints and positions away from zero.
    pub posture: Posture,
    /// Physics steps until episodes may start.
    pub steps: usize,
}

/// Whose figures a scene follows. In both the world's origin is the centre of the table;
/// Meta-World's own is 0.6 m nearer to the robot.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Layout {
    /// Centred, settled, off-centre placements: four variants in four quadrants.
    #[default]
    Symmetric,
    /// Meta-World's ranges, hand starts, bounds, finger strokes and contact shapes; one variant,
    /// the identity.
    MetaWorld,
}

impl Layout {
    /// Every layout.
    pub const ALL: [Self; 2] = [Self::Symmetric, Self::MetaWorld];

    /// The name as options spell it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Symmetric => "symmetric",
            Self::MetaWorld => "metaworld",
        }
    }

    /// The variants that a group has in this layout.
    pub fn elements(self) -> &'static [D2] {
        match self {
            Self::Symmetric => &D2::ALL,
            Self::MetaWorld => &[D2::Identity],
        }
    }

    /// The control settings that go with this layout.
    pub fn control(self) -> Control {
        match self {
            Self::Symmetric => Control::default(),
            Self::MetaWorld => Control::meta_world(),
        }
    }

    /// Lowest and highest corner (metres) of the box that holds the hand's target.
    pub fn target_bounds(self) -> [DVec3; 2] {
        match self {
            // wider along y than the hand needs, so that a blocked hand can push
            Self::Symmetric => [DVec3::new(-0.3, -0.3, 0.05), DVec3::new(0.3, 0.3, 0.35)],
            Self::MetaWorld => [DVec3::new(-0.5, -0.2, 0.05), DVec3::new(0.5, 0.4, 0.5)],
        }
    }

    /// Meta-World's figures of the group, in the layout that follows them.
    pub(crate) fn stock(self, group: TaskGroup) -> Result<Option<Stock<'static>>, EnvError> {
        let layout = self.name();
        match (self, group.task().stock()) {
            (Self::Symmetric, _) => Ok(None),
            (Self::MetaWorld, Some(stock)) => Ok(Some(stock)),
            (Self::MetaWorld, None) => Err(EnvError::NoSuchLayout { layout, group }),
        }
    }

    /// How a scene with the hand's target at `hand_target` (metres) comes to where its episodes
    /// start.
    ///
    /// # Errors
    /// Why `carrier` has no posture there.
    pub(crate) fn settling(
        self,
        hand_target: DVec3,
        carrier: &dyn Carrier,
    ) -> Result<Settling, EnvError> {
        let posture = match self.stock_carrier(carrier) {
            // the stock arm comes from its initial pose, stretched to the side
            Some(_) => Posture::new(),
            None => carrier.posture(hand_target)?,
        };
        let steps = match self {
            Self::Symmetric => SETTLED,
            Self::MetaWorld => STOCK_RESET,
        };
        Ok(Settling { hand_target, posture, steps })
    }

    /// The part of a scene that the embodiment has in this layout alone.
    pub(crate) fn stock_carrier(self, carrier: &dyn Carrier) -> Option<&str> {
        match self {
            Self::Symmetric => None,
            Self::MetaWorld => carrier.stock(),
        }
    }

    /// Files that other parts include by name.
    pub(crate) fn included(self) -> &'static [Mjcf<'static>] {
        match self {
            Self::Symmetric => &SYMMETRIC,
            Self::MetaWorld => &META_WORLD,
        }
    }

    /// Refuses an element that this layout has no variant for.
    pub(crate) fn check(self, element: D2) -> Result<(), EnvError> {
        if self.elements().contains(&element) {
            return Ok(());
        }
        Err(EnvError::NoSuchVariant { layout: self.name(), element })
    }
}

impl std::fmt::Display for Layout {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// Maps a point between the canonical and the world frame; every element is its own inverse.
pub(crate) fn map(element: D2, point: DVec3) -> DVec3 {
    let [x, y] = element.apply_xy([point.x, point.y]);
    DVec3::new(x, y, point.z)
}

/// Orientation (w, x, y, z) of an object under `element`: flips along y turn it by half a turn
/// instead of mirroring it, which is the same for objects that are their own mirror image along x.
pub(crate) fn facing(element: D2) -> [f64; 4] {
    if element.flips_y() { [0.0, 0.0, 0.0, 1.0] } else { [1.0, 0.0, 0.0, 0.0] }
}
