//! What a task says about itself, and the handle by which the rest of the crate knows it.

use std::any::Any;

use glam::DVec3;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

use crate::identity::{Identity, stands_for_its_name};

/// A group of tasks that are one another's images under [`D2`]: a handle on the [`Task`] that
/// defines the identity variant.
///
/// Groups are compared, ordered, hashed, printed and serialised by their names, so two tasks of one
/// name count as one group; [`TaskRegistry`](crate::TaskRegistry) refuses the second, and so does a
/// [`VecEnv`](crate::VecEnv). A name is turned back to a group by a registry.
#[derive(Clone, Copy)]
pub struct TaskGroup(&'static dyn Task);

impl TaskGroup {
    /// The group of `task`.
    ///
    /// A reference to a task without fields is `'static` already: `TaskGroup::of(&MyTask)`. A task
    /// that is made while the program runs is leaked: `TaskGroup::of(Box::leak(Box::new(task)))`.
    /// Make the handle of a task with fields once and copy it: a task made again is another one.
    pub const fn of(task: &'static dyn Task) -> Self {
        Self(task)
    }

    /// The group's name as options and files spell it, for instance `goal-reach`.
    pub fn name(self) -> &'static str {
        self.0.name()
    }

    /// The task that defines the group's identity variant.
    pub fn task(self) -> &'static dyn Task {
        self.0
    }

    /// What tells this task from another one of its name.
    pub(crate) fn identity(self) -> Identity {
        Identity::of(self.0)
    }

    /// The group's variants, one for each element of [`D2::ALL`].
    pub fn variants(self) -> [TaskVariant; 4] {
        D2::ALL.map(|element| TaskVariant { group: self, element })
    }
}

stands_for_its_name!(TaskGroup);

/// One task: a group and the symmetry that maps the group's identity variant to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TaskVariant {
    /// The group.
    pub group: TaskGroup,
    /// The element that maps the canonical scene to this one.
    pub element: D2,
}

impl std::fmt::Display for TaskVariant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}", self.group, self.element)
    }
}

/// Where an episode puts things, in the canonical frame (metres from the table's centre).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Origin of the scene's `object` body; unused by scenes without one.
    pub object: DVec3,
    /// The point where the object, or the fingertips, should be; a scene's `goal` body has its
    /// origin there.
    pub goal: DVec3,
}

/// What the reward looks at, in the canonical frame (metres).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement {
    /// Origin of the hand body.
    pub hand: DVec3,
    /// The point between the fingertips.
    pub tcp: DVec3,
    /// Distance between the claws over 0.1 m, in `[0, 1]`; one is open.
    pub aperture: f64,
    /// The point of the object that the task speaks of (see [`Parts::object_offset`]).
    pub object: DVec3,
}

/// How an episode began, in the canonical frame (metres).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EpisodeStart {
    /// Where things were put.
    pub placement: Placement,
    /// Where the hand's target stood; the hand itself rests a few millimetres below it.
    pub hand_target: DVec3,
    /// What was measured.
    pub measured: Measurement,
}

/// Reward in `[0, 10]` and success of one control step, and the terms that the reward is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepReward {
    /// How near the fingertips are to the object, and where the task asks for it how the fingers
    /// are held, in `[0, 1]`; 1 in Goal Reach.
    pub approach: f64,
    /// How near the object is to its goal, in `[0, 1]`.
    pub in_place: f64,
    /// How far the object is from its goal (metres); in Goal Reach the fingertips.
    pub remaining: f64,
    /// The dense reward, in `[0, 10]`.
    pub reward: f64,
    /// Whether the success condition holds now.
    pub success: bool,
}

/// The unchanging parts of a task. `Parts::default()` is the bare table with a hidden goal.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Parts<'a> {
    /// The task's part of the scene, a `<mujocoinclude>`; none for the bare table.
    ///
    /// A part needs a mocap body `object`, which is put where the placement says, and may have a
    /// mocap body `goal`. Both are turned by half a turn in the variants that flip y, so everything
    /// in them must be its own mirror image along x. What the learner should see is in geom group 1
    /// and made of boxes or upright cylinders, which draw as exact mirror images; what only
    /// collides is in group 4. Everything has a name. A geom that collides keeps the embodiment's
    /// `contype` and `conaffinity`; one that does not sets both to 0.
    ///
    /// The part may include by name what the stock tasks include: `drawer_stop.xml` and `puck.xml`
    /// of the embodiment; `plunger.xml`, `handle.xml` and `bars.xml` of the layout. The arena, the
    /// embodiment and the camera are in every scene.
    ///
    /// Reserved names: a body `goal` is placed by the environment and must be a mocap body. The
    /// names of the arena and the embodiment are taken, for instance the bodies `hand`
    /// and `hand_target`, the sites `right_tip` and `left_tip` and the camera `top`.
    pub mjcf: Option<&'a str>,
    /// Body whose position the task reads; without one, the placement's object is read.
    pub object_body: Option<&'a str>,
    /// From that body's origin to the point that the task speaks of (metres, canonical frame);
    /// finite.
    pub object_offset: DVec3,
    /// Joints that an episode starts away from zero, with their positions (metres, radians), which
    /// are finite.
    pub start_joints: &'a [(&'a str, f64)],
    /// Whether the goal is part of the observation.
    pub goal_observable: bool,
}

/// Meta-World's own figures of a task, for the layout `metaworld`.
#[derive(Clone, Copy, Debug)]
pub struct Stock<'a> {
    /// Meta-World's name of the task, without its version.
    pub name: &'a str,
    /// Where the hand's target stands when an episode starts (metres).
    pub hand_target: DVec3,
    /// A part that the scene has in this layout alone, a `<mujocoinclude>`. With it the name
    /// `decoy` is reserved for a free joint: an episode starts with its body at the placement's
    /// object.
    pub addition: Option<&'a str>,
    /// Draws a placement from Meta-World's ranges.
    pub place: fn(&mut ChaCha8Rng) -> Placement,
}

/// A task in its canonical frame; it keeps no state between calls.
///
/// Its four variants are made by mapping positions and actions with the elements of [`D2`].
/// [`conformance::check`](crate::conformance::check) tries whether a task does what is asked here.
pub trait Task: Any + Send + Sync {
    /// The name, in kebab-case: lower-case letters and digits in words that are joined by hyphens.
    fn name(&self) -> &str;

    /// What the task is made of.
    fn parts(&self) -> Parts<'_>;

    /// Draws a placement. All draws of the object, or all of the goal, lie in one quadrant and more
    /// than 1 mm off its axes, so that the four variants fill four quadrants.
    fn place(&self, rng: &mut ChaCha8Rng) -> Placement;

    /// Reward and success of the state `now` of an episode that began as `start`, where `finger` is
    /// the action's finger component in `[-1, 1]`.
    fn reward(&self, start: &EpisodeStart, now: &Measurement, finger: f64) -> StepReward;

    /// The scripted expert: where the hand should go next, and the finger action.
    fn expert(&self, placement: &Placement, now: &Measurement) -> ExpertCommand;

    /// Meta-World's figures of the task. A task without them has no scene in the layout
    /// `metaworld`.
    fn stock(&self) -> Option<Stock<'_>> {
        None
    }
}

/// What a scripted expert asks for, in the canonical frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpertCommand {
    /// Where the hand should go (metres).
    pub hand: DVec3,
    /// Finger action in `[-1, 1]`; one closes.
    pub finger: f64,
}
