//! Definition of a task, and the handle that the rest of the crate uses.

use std::any::Any;

use glam::DVec3;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

use crate::instance_id::{InstanceId, impl_traits_by_name};

/// Group of tasks that are images of one another under [`D2`]: a handle on the [`Task`] that
/// defines the identity variant.
///
/// Groups are compared, ordered, hashed, printed and serialised by name, so two tasks of one name
/// count as one group; [`TaskRegistry`](crate::TaskRegistry) and [`VecEnv`](crate::VecEnv) reject
/// the second. A registry converts a name back to a group.
#[derive(Clone, Copy)]
pub struct TaskGroup(&'static dyn Task);

impl TaskGroup {
    /// Returns the handle of the task group that `task` defines: its four variants under D2, with
    /// `task` as the identity variant.
    ///
    /// A reference to a task without fields is `'static` already: `TaskGroup::from_task(&MyTask)`.
    /// A task that is made at run time must be leaked:
    /// `TaskGroup::from_task(Box::leak(Box::new(task)))`. Make the handle of a task with fields
    /// once and copy it: another instance counts as another task.
    pub const fn from_task(task: &'static dyn Task) -> Self {
        Self(task)
    }

    /// Returns the group's name as options and files spell it, for instance `goal-reach`.
    pub fn name(self) -> &'static str {
        self.0.name()
    }

    /// Returns the task that defines the group's identity variant.
    pub fn identity_task(self) -> &'static dyn Task {
        self.0
    }

    /// Returns an id that distinguishes the task from another one with the same name.
    pub(crate) fn instance_id(self) -> InstanceId {
        InstanceId::of(self.0)
    }

    /// Returns the group's four variants, one for each element of [`D2::ALL`].
    pub fn variants(self) -> [TaskVariant; 4] {
        D2::ALL.map(|element| TaskVariant { group: self, element })
    }
}

impl_traits_by_name!(TaskGroup);

/// Variant of a task group: the group, and the symmetry that maps its identity variant to this one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TaskVariant {
    /// Task group of the variant.
    pub group: TaskGroup,
    /// Element of D2 that maps the canonical variant to this one.
    pub element: D2,
}

impl std::fmt::Display for TaskVariant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}", self.group, self.element)
    }
}

/// Positions of object and goal in an episode, in the canonical frame (metres from the table's
/// centre).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Position of the scene's `object` body (its origin); unused by scenes without one.
    pub object: DVec3,
    /// Target position of the object or the fingertips, and origin of the scene's `goal` body.
    pub goal: DVec3,
}

/// State of a task, on which reward and expert depend, in the canonical frame (metres).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TaskState {
    /// Position of the origin of the hand body (metres).
    pub hand: DVec3,
    /// Position of the tool centre point, between the fingertips (metres).
    pub tcp: DVec3,
    /// Distance between the claws divided by 0.1 m, in `[0, 1]`; 1 is open.
    pub aperture: f64,
    /// Position of the object's reference point (metres; see [`TaskSceneParts::object_offset`]).
    pub object: DVec3,
    /// Position of the object's second point (metres; see [`TaskSceneParts::tip_body`]).
    pub tip: DVec3,
    /// Positions along y of the two finger pads (metres): first the one that is further to -y when
    /// the hand does not turn.
    pub pads: [f64; 2],
}

/// Start of an episode: placement, the hand's target and the task's state, in the canonical frame
/// (metres).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EpisodeStart {
    /// Positions of object and goal in the episode.
    pub placement: Placement,
    /// Position of the hand's target at the start (metres).
    ///
    /// In the symmetric layout a hand that a weld moves rests 4 mm below it; in Meta-World's layout
    /// it is not at rest yet. An arm with servos rests at the target.
    pub hand_target: DVec3,
    /// State of the task at the start of the episode.
    pub task_state: TaskState,
}

/// Reward, success and reward terms of one control step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepReward {
    /// Reward term in `[0, 1]` for the distance of the fingertips from the object and, in some
    /// tasks, for the finger action; 1 in Goal Reach.
    pub approach_reward: f64,
    /// Reward term in `[0, 1]` for the distance of the object from its goal.
    pub in_place_reward: f64,
    /// Distance of the object (in Goal Reach, the fingertips) from its goal (metres).
    pub goal_distance: f64,
    /// Dense reward of the control step, in `[0, 10]`.
    pub reward: f64,
    /// `true` if the success condition holds after the control step.
    pub success: bool,
}

/// Parts of a task's scene that are the same in all episodes. `TaskSceneParts::default()` is the
/// bare table with a hidden goal.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TaskSceneParts<'a> {
    /// MJCF of the task's objects, a `<mujocoinclude>`; `None` for the bare table.
    ///
    /// A mocap body `object`, which is moved to the placement's object, is required; with a
    /// [`loose_joint`](Self::loose_joint) it is refused. A mocap body `goal` is optional. Both are
    /// rotated by half a turn in the variants that flip y, so everything in them must be symmetric
    /// along x, or the task [`handed`](Self::handed). Visible geoms are in group 1 and are boxes or
    /// upright cylinders, which are drawn as exact mirror images; collision shapes are in group 4.
    /// Everything has a name, and angles are in radians. Elements `compiler` and `option`, which
    /// would change the whole scene, are refused. A geom that collides keeps the embodiment's
    /// `contype` and `conaffinity`; one that does not sets both to 0.
    ///
    /// The part may include the files that the crate's own tasks include: `drawer_stop.xml` and
    /// `puck.xml` of the embodiment; `plunger.xml`, `handle.xml` and `bars.xml` of the layout.
    /// Arena, embodiment and camera are in every scene.
    ///
    /// Reserved names: the body `goal`, which the environment places, must be a mocap body. The
    /// names of arena and embodiment are taken, for instance the bodies `hand` and `hand_target`,
    /// the sites `right_tip` and `left_tip` and the camera `top`.
    pub mjcf: Option<&'a str>,
    /// Name of the body whose position the task reads; if `None`, the placement's object is read.
    pub object_body: Option<&'a str>,
    /// Offset from the origin of `object_body` to the task's reference point (metres, canonical
    /// frame); finite.
    pub object_offset: DVec3,
    /// Name of another body whose position the task reads; if `None`, the reference point is read
    /// twice.
    pub tip_body: Option<&'a str>,
    /// Name of a free joint, whose body starts at rest at the placement's object.
    pub loose_joint: Option<&'a str>,
    /// Names of the joints that do not start at zero, with their start positions (metres, radians);
    /// finite.
    pub start_joints: &'a [(&'a str, f64)],
    /// Position of the hand's target when an episode of the symmetric layout starts (metres,
    /// canonical frame), within [`Layout::hand_target_bounds`](crate::Layout::hand_target_bounds);
    /// `None` for [`HAND_TARGET_START`](crate::HAND_TARGET_START), the same in all variants. The
    /// hand comes to rest there before objects are placed and joints set, so it must be clear of
    /// where the MJCF has them.
    pub hand_target: Option<DVec3>,
    /// `true` if objects are not their own mirror images along x, for instance a door with its
    /// hinges on the left. Variants that flip one axis then have mirrored objects, whose joints
    /// keep their coordinates. [`Model::with_mirrored_bodies`](mujoco::Model::with_mirrored_bodies)
    /// says what such objects may hold.
    pub handed: bool,
    /// `true` if the goal is part of the vector observation; otherwise zeros take its place.
    pub goal_observable: bool,
}

/// Settings of a task in the layout `metaworld`, from Meta-World.
#[derive(Clone, Copy, Debug)]
pub struct MetaWorldTaskSettings<'a> {
    /// Meta-World's name of the task, without its version.
    pub name: &'a str,
    /// Position of the hand's target when an episode starts (metres, world frame).
    pub hand_target: DVec3,
    /// Lowest height of the hand's target (metres).
    pub lowest_target: f64,
    /// Names of further joints that do not start where they come to rest, with their start
    /// positions (metres, radians); finite.
    pub start_joints: &'a [(&'a str, f64)],
    /// Additional MJCF of the scene, a `<mujocoinclude>`. The name `decoy` is then reserved for a
    /// free joint, whose body starts at the placement's object.
    pub extra_mjcf: Option<&'a str>,
    /// Function that draws a placement from Meta-World's ranges.
    pub sample_placement: fn(&mut ChaCha8Rng) -> Placement,
}

/// Definition of a task in its canonical frame; it keeps no state between calls.
///
/// The four variants follow from mapping positions and actions by the elements of [`D2`].
/// [`conformance::check_task_conformance`](crate::conformance::check_task_conformance) tests the
/// requirements.
pub trait Task: Any + Send + Sync {
    /// Returns the task's name in kebab-case: words of lower-case letters and digits, joined by
    /// hyphens.
    fn name(&self) -> &str;

    /// Returns the parts of the task's scene that are the same in all episodes.
    fn parts(&self) -> TaskSceneParts<'_>;

    /// Draws a random placement of object and goal. All objects, or all goals, must lie in one
    /// quadrant and more than 1 mm off its axes, so that the four variants fill four quadrants.
    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement;

    /// Returns reward and success of the state `now` of an episode with the start `start`; `finger`
    /// is the action's finger component in `[-1, 1]`.
    fn reward(&self, start: &EpisodeStart, now: &TaskState, finger: f64) -> StepReward;

    /// Returns the scripted expert's next command.
    fn expert(&self, placement: &Placement, now: &TaskState) -> ExpertCommand;

    /// Returns the task's settings for the layout `metaworld`; `None` if the task has no scene in
    /// that layout.
    fn meta_world_settings(&self) -> Option<MetaWorldTaskSettings<'_>> {
        None
    }
}

/// Command of a scripted expert: target of the hand in the canonical frame, and finger action.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpertCommand {
    /// Commanded target of the hand (metres).
    pub hand: DVec3,
    /// Commanded finger action in `[-1, 1]`; 1 closes.
    pub finger: f64,
}
