//! Task groups, their variants, and what every task says about itself.

use glam::DVec3;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use symmetry::D2;

use crate::EnvError;
use crate::tasks::{ButtonPress, DrawerClose, GoalReach, PlateSlide};

/// A group of tasks that are one another's images under [`D2`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TaskGroup {
    /// Move the fingertips to a goal that is told, not seen.
    GoalReach,
    /// Push a button into its box.
    ButtonPress,
    /// Push a drawer shut.
    DrawerClose,
    /// Slide a puck into a goal cage.
    PlateSlide,
}

impl TaskGroup {
    /// Every group, in the order of reports.
    pub const ALL: [Self; 4] = [
        Self::GoalReach,
        Self::ButtonPress,
        Self::DrawerClose,
        Self::PlateSlide,
    ];

    /// The group's name as options and files spell it, for instance `goal-reach`.
    pub fn name(self) -> &'static str {
        match self {
            Self::GoalReach => "goal-reach",
            Self::ButtonPress => "button-press",
            Self::DrawerClose => "drawer-close",
            Self::PlateSlide => "plate-slide",
        }
    }

    /// The task that defines the group's identity variant.
    pub fn task(self) -> &'static dyn Task {
        match self {
            Self::GoalReach => &GoalReach,
            Self::ButtonPress => &ButtonPress,
            Self::DrawerClose => &DrawerClose,
            Self::PlateSlide => &PlateSlide,
        }
    }
}

impl std::fmt::Display for TaskGroup {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for TaskGroup {
    type Err = EnvError;

    fn from_str(name: &str) -> Result<Self, EnvError> {
        Self::ALL
            .into_iter()
            .find(|group| group.name() == name)
            .ok_or_else(|| EnvError::UnknownTask {
                name: name.to_owned(),
            })
    }
}

/// One task: a group and the symmetry that maps the group's identity variant to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TaskVariant {
    /// The group.
    pub group: TaskGroup,
    /// The element that maps the canonical scene to this one.
    pub element: D2,
}

impl TaskVariant {
    /// The 16 variants: every group under every element.
    pub fn all() -> impl Iterator<Item = Self> {
        TaskGroup::ALL.into_iter().flat_map(|group| {
            D2::ALL
                .into_iter()
                .map(move |element| Self { group, element })
        })
    }
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
    /// Where the hand's target stands when the episode starts.
    pub hand_start: DVec3,
    /// The point where the object, or the fingertips, should be; a scene's `goal` body has its origin there.
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

/// Reward in `[0, 10]` and success of one control step, and the terms that the reward is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evaluation {
    /// How near the fingertips are to the object, and where the task asks for it how the fingers are held, in `[0, 1]`; 1 in Goal Reach.
    pub approach: f64,
    /// How near the object is to its goal, in `[0, 1]`.
    pub in_place: f64,
    /// How far the object is from its goal (metres); in Goal Reach the fingertips.
    pub remaining: f64,
    /// Meta-World's dense reward, in `[0, 10]`.
    pub reward: f64,
    /// Whether the success condition holds now.
    pub success: bool,
}

/// The unchanging parts of a task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parts {
    /// File name of the scene in `assets/mjcf` and its text; none for the bare table.
    pub scene: Option<(&'static str, &'static str)>,
    /// Body whose position the task reads; without one, the goal is the object.
    pub object_body: Option<&'static str>,
    /// From that body's origin to the point that the task speaks of (metres).
    pub object_offset: DVec3,
    /// Joints that an episode starts away from zero, with their positions (metres).
    pub start_joints: &'static [(&'static str, f64)],
    /// Whether the learner is told the goal.
    pub tells_goal: bool,
}

/// A task in its canonical frame; it keeps no state between calls.
///
/// Figures are Meta-World's with the table's centre moved to the origin, unless the task says otherwise.
pub trait Task: Send + Sync {
    /// What the task is made of.
    fn parts(&self) -> &'static Parts;

    /// Draws a placement; x is drawn off-centre, so that the four variants fill four quadrants.
    fn place(&self, rng: &mut ChaCha8Rng) -> Placement;

    /// Draws a placement from Meta-World's ranges.
    fn place_stock(&self, rng: &mut ChaCha8Rng) -> Placement;

    /// Reward and success of the state `now`, given the state at the episode's start and the action's finger component in `[-1, 1]`.
    fn evaluate(
        &self,
        placement: &Placement,
        start: &Measurement,
        now: &Measurement,
        finger: f64,
    ) -> Evaluation;

    /// The scripted expert: where the hand should go next, how hard (displacement per metre of error), and the finger action.
    fn expert(&self, placement: &Placement, now: &Measurement) -> ExpertCommand;
}

/// What a scripted expert asks for, in the canonical frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpertCommand {
    /// Where the hand should go (metres).
    pub hand: DVec3,
    /// Finger action in `[-1, 1]`; one closes.
    pub finger: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_parse_back_and_unknown_ones_list_the_choices() {
        for group in TaskGroup::ALL {
            assert_eq!(group.name().parse::<TaskGroup>().unwrap(), group);
        }
        let message = "peg-insert".parse::<TaskGroup>().unwrap_err().to_string();
        assert!(message.contains("peg-insert") && message.contains("drawer-close"));
    }

    #[test]
    fn there_are_sixteen_variants() {
        let all: std::collections::HashSet<_> = TaskVariant::all().collect();
        assert_eq!(all.len(), 16);
    }
}
