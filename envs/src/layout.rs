//! Layouts of the tasks: the symmetric one for training, and Meta-World's own for comparison.

use glam::DVec3;
use serde::{Deserialize, Serialize};
use symmetry::D2;

use crate::actuation::NamedJointPositions;
use crate::control::ControlSettings;
use crate::embodiment_spec::EmbodimentSpec;
use crate::error::EnvError;
use crate::mjcf::{Mjcf, parts};
use crate::task::{MetaWorldTaskSettings, TaskGroup};

/// Position of the hand's target at the start of every episode of the symmetric layout (metres):
/// above the centre, clear of an open drawer.
pub const HAND_TARGET_START: DVec3 = DVec3::new(0.0, 0.0, 0.22);

/// Expands to the files of one layout's folder that other parts include by name.
macro_rules! layout_parts {
    ($folder:literal) => {
        parts!([
            "bars.xml", "cabinet.xml", "door_leaf.xml", "faucet_base.xml", "faucet_handle.xml",
            "handle.xml", "left_finger.xml", "loose_block.xml", "lying_box.xml", "peg.xml",
            "peg_box.xml", "plunger.xml", "window_frame.xml",
            "window_pane.xml"
        ] in $folder)
    };
}

const SYMMETRIC: &[Mjcf<'static>] = &layout_parts!("symmetric");
const META_WORLD: &[Mjcf<'static>] = &layout_parts!("metaworld");

/// Number of physics steps in which a hand comes to rest at its start: 10 s.
const SETTLED: usize = 4000;
/// Number of physics steps of Meta-World's reset: 0.625 s, after which its arm is still moving.
const META_WORLD_RESET: usize = 250;

/// Settings of the simulation that leads to the start state of episodes.
pub(crate) struct SettlingSettings {
    /// Position of the hand's target (metres).
    pub hand_target: DVec3,
    /// Initial positions of the joints that do not start at zero.
    pub joint_positions: NamedJointPositions,
    /// Number of physics steps before episodes may start, if a weld moves the hand.
    pub steps: usize,
}

/// Geometry that a scene follows. The world's origin is the centre of the table in both layouts;
/// Meta-World's own origin is 0.6 m nearer to the robot.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Layout {
    /// Layout for training, with centred bounds, a start at rest and off-centre placements: four
    /// variants in four quadrants.
    #[default]
    Symmetric,
    /// Layout of Meta-World, with its ranges, hand starts, bounds, finger strokes and contact
    /// shapes; only the identity variant.
    MetaWorld,
}

impl Layout {
    /// All layouts: the symmetric one and Meta-World's.
    pub const ALL: [Self; 2] = [Self::Symmetric, Self::MetaWorld];

    /// Returns the layout's name as options spell it: `symmetric` or `metaworld`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Symmetric => "symmetric",
            Self::MetaWorld => "metaworld",
        }
    }

    /// Returns the elements of D2 whose variants a task group has in this layout.
    pub fn group_elements(self) -> &'static [D2] {
        match self {
            Self::Symmetric => &D2::ALL,
            Self::MetaWorld => &[D2::Identity],
        }
    }

    /// Returns the layout's action settings: displacement by a full action (metres a decision),
    /// action repeat and horizon (both in control steps of 12.5 ms).
    pub fn control_settings(self) -> ControlSettings {
        match self {
            Self::Symmetric => ControlSettings::default(),
            Self::MetaWorld => ControlSettings::meta_world(),
        }
    }

    /// Returns the lowest and the highest corner (metres) of the box that holds the hand's target;
    /// in Meta-World's layout each task sets its own lowest height instead.
    pub fn hand_target_bounds(self) -> [DVec3; 2] {
        match self {
            // wider along y than the hand needs, so that a target beyond a blocked hand makes it
            // push
            Self::Symmetric => [DVec3::new(-0.3, -0.3, 0.05), DVec3::new(0.3, 0.3, 0.35)],
            Self::MetaWorld => [DVec3::new(-0.5, -0.2, 0.05), DVec3::new(0.5, 0.4, 0.5)],
        }
    }

    /// Returns Meta-World's settings of the task of `group`; `None` in the symmetric layout.
    pub(crate) fn meta_world_settings(
        self,
        group: TaskGroup,
    ) -> Result<Option<MetaWorldTaskSettings<'static>>, EnvError> {
        let layout = self.name();
        match (self, group.identity_task().meta_world_settings()) {
            (Self::Symmetric, _) => Ok(None),
            (Self::MetaWorld, Some(spec)) => Ok(Some(spec)),
            (Self::MetaWorld, None) => Err(EnvError::NoSuchLayout { layout, group }),
        }
    }

    /// Returns the settings of the simulation that leads to the start state, with the hand's target
    /// at `hand_target` (metres).
    ///
    /// # Errors
    /// Errors of [`EmbodimentSpec::initial_joint_positions`].
    pub(crate) fn settling(
        self,
        hand_target: DVec3,
        spec: &dyn EmbodimentSpec,
    ) -> Result<SettlingSettings, EnvError> {
        let joint_positions = match self.meta_world_mjcf(spec) {
            // Meta-World's arm starts from the model's initial pose, stretched to the side
            Some(_) => NamedJointPositions::new(),
            None => spec.initial_joint_positions(hand_target)?,
        };
        let steps = match self {
            Self::Symmetric => SETTLED,
            Self::MetaWorld => META_WORLD_RESET,
        };
        Ok(SettlingSettings { hand_target, joint_positions, steps })
    }

    /// Returns the embodiment's MJCF for this layout, if it is not the usual one.
    pub(crate) fn meta_world_mjcf(self, spec: &dyn EmbodimentSpec) -> Option<&str> {
        match self {
            Self::Symmetric => None,
            Self::MetaWorld => spec.meta_world_mjcf(),
        }
    }

    /// Returns the MJCF files that parts of a scene in this layout include by name.
    pub(crate) fn included_files(self) -> &'static [Mjcf<'static>] {
        match self {
            Self::Symmetric => SYMMETRIC,
            Self::MetaWorld => META_WORLD,
        }
    }

    /// Rejects an element of D2 that this layout has no variant for.
    pub(crate) fn check_variant(self, element: D2) -> Result<(), EnvError> {
        if self.group_elements().contains(&element) {
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

/// Maps a point from the canonical frame of the variant `element` to the world frame, or back.
/// Every element is its own inverse.
pub(crate) fn map_point(element: D2, point: DVec3) -> DVec3 {
    let [x, y] = element.apply_xy([point.x, point.y]);
    DVec3::new(x, y, point.z)
}

/// Returns the orientation (w, x, y, z) of an object under `element`. A flip along y rotates it by
/// half a turn instead of mirroring it, which is equivalent for objects that are symmetric along x.
pub(crate) fn orientation_quat(element: D2) -> [f64; 4] {
    if element.flips_y() { [0.0, 0.0, 0.0, 1.0] } else { [1.0, 0.0, 0.0, 0.0] }
}

/// Returns `true` if an object that is not its own mirror image is mirrored under `element`: two
/// flips are half a turn.
pub(crate) fn mirrors_objects(element: D2) -> bool {
    element.flips_x() != element.flips_y()
}
