//! Named task groups: the paper's four, those of Meta-World's MT10, and those that a program adds.

use crate::error::EnvError;
use crate::task::TaskGroup;
use crate::tasks::{
    ButtonPress, ButtonPressTopdown, DoorClose, DoorOpen, DrawerClose, DrawerOpen, FaucetClose,
    GoalReach, PegInsertSide, PickPlace, PlateSlide, Push, WindowClose, WindowOpen,
};

impl TaskGroup {
    /// Task group of moving the fingertips to a goal that the vector observation contains and
    /// pictures do not show.
    pub const GOAL_REACH: Self = Self::from_task(&GoalReach);
    /// Task group of pushing a button into its box.
    pub const BUTTON_PRESS: Self = Self::from_task(&ButtonPress);
    /// Task group of pushing a drawer shut.
    pub const DRAWER_CLOSE: Self = Self::from_task(&DrawerClose);
    /// Task group of sliding a puck into a goal cage.
    pub const PLATE_SLIDE: Self = Self::from_task(&PlateSlide);

    /// Task group of sliding a window open.
    pub const WINDOW_OPEN: Self = Self::from_task(&WindowOpen);
    /// Task group of sliding a window shut.
    pub const WINDOW_CLOSE: Self = Self::from_task(&WindowClose);
    /// Task group of pulling the door of a cabinet open.
    pub const DOOR_OPEN: Self = Self::from_task(&DoorOpen);
    /// Task group of pushing the door of a cabinet shut.
    pub const DOOR_CLOSE: Self = Self::from_task(&DoorClose);
    /// Task group of pulling a drawer open.
    pub const DRAWER_OPEN: Self = Self::from_task(&DrawerOpen);
    /// Task group of pushing a button that faces up into its box.
    pub const BUTTON_PRESS_TOPDOWN: Self = Self::from_task(&ButtonPressTopdown);
    /// Task group of turning the handle of a faucet.
    pub const FAUCET_CLOSE: Self = Self::from_task(&FaucetClose);
    /// Task group of sliding a block over the table to a marked goal.
    pub const PUSH: Self = Self::from_task(&Push);
    /// Task group of carrying a block to a marked goal in the air.
    pub const PICK_PLACE: Self = Self::from_task(&PickPlace);
    /// Task group of inserting a peg into a box from the side.
    pub const PEG_INSERT_SIDE: Self = Self::from_task(&PegInsertSide);

    /// All four task groups of the COVERS paper, in the order in which reports list them.
    pub const STANDARD: [Self; 4] =
        [Self::GOAL_REACH, Self::BUTTON_PRESS, Self::DRAWER_CLOSE, Self::PLATE_SLIDE];
    /// Task groups of Meta-World's MT10, in its order.
    pub const MT10: [Self; 10] = [
        Self::GOAL_REACH,
        Self::PUSH,
        Self::PICK_PLACE,
        Self::DOOR_OPEN,
        Self::DRAWER_OPEN,
        Self::DRAWER_CLOSE,
        Self::BUTTON_PRESS_TOPDOWN,
        Self::PEG_INSERT_SIDE,
        Self::WINDOW_OPEN,
        Self::WINDOW_CLOSE,
    ];

    /// Ten of the task groups in which the gripper never has to hold an object: first the four
    /// [`TaskGroup::STANDARD`].
    pub const TEN_WITHOUT_GRASPING: [Self; 10] = [
        Self::GOAL_REACH,
        Self::BUTTON_PRESS,
        Self::DRAWER_CLOSE,
        Self::PLATE_SLIDE,
        Self::WINDOW_OPEN,
        Self::WINDOW_CLOSE,
        Self::DOOR_OPEN,
        Self::DRAWER_OPEN,
        Self::BUTTON_PRESS_TOPDOWN,
        Self::FAUCET_CLOSE,
    ];

    /// All task groups of this crate: the standard ones first.
    pub const ALL: [Self; 14] = [
        Self::GOAL_REACH,
        Self::BUTTON_PRESS,
        Self::DRAWER_CLOSE,
        Self::PLATE_SLIDE,
        Self::WINDOW_OPEN,
        Self::WINDOW_CLOSE,
        Self::DOOR_OPEN,
        Self::DOOR_CLOSE,
        Self::DRAWER_OPEN,
        Self::BUTTON_PRESS_TOPDOWN,
        Self::FAUCET_CLOSE,
        Self::PUSH,
        Self::PICK_PLACE,
        Self::PEG_INSERT_SIDE,
    ];

    /// Sets of task groups by name: `standard`, `ten`, `mt10` and `all`.
    pub const TASK_SETS: [(&str, &[Self]); 4] = [
        ("standard", &Self::STANDARD),
        ("ten", &Self::TEN_WITHOUT_GRASPING),
        ("mt10", &Self::MT10),
        ("all", &Self::ALL),
    ];

    /// Rejects a task group whose name is not in kebab-case.
    ///
    /// # Errors
    /// [`EnvError::InvalidTaskName`].
    pub fn check_name(self) -> Result<(), EnvError> {
        if self.name().split('-').all(is_word) {
            return Ok(());
        }
        Err(EnvError::InvalidTaskName { name: self.name().to_owned() })
    }
}

fn is_word(word: &str) -> bool {
    let plain = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit();
    !word.is_empty() && word.bytes().all(plain)
}

/// Registry of task groups by name, for reading settings that store names.
///
/// ```
/// use envs::{TaskGroup, TaskRegistry};
///
/// fn main() -> Result<(), envs::EnvError> {
///     let registry = TaskRegistry::with_standard();
///     assert_eq!(registry.find("drawer-close")?, TaskGroup::DRAWER_CLOSE);
///     Ok(())
/// }
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TaskRegistry {
    groups: Vec<TaskGroup>,
}

impl TaskRegistry {
    /// Creates a registry of [`TaskGroup::STANDARD`].
    pub fn with_standard() -> Self {
        Self { groups: TaskGroup::STANDARD.to_vec() }
    }

    /// Creates a registry of [`TaskGroup::ALL`].
    pub fn with_all() -> Self {
        Self { groups: TaskGroup::ALL.to_vec() }
    }

    /// Adds a task group to the registry, under its name.
    ///
    /// # Errors
    /// [`EnvError::InvalidTaskName`] for a name that is not in kebab-case,
    /// [`EnvError::DuplicateTask`] for one that is taken.
    pub fn register(&mut self, group: TaskGroup) -> Result<(), EnvError> {
        group.check_name()?;
        if self.groups.contains(&group) {
            let name = group.name().to_owned();
            return Err(EnvError::DuplicateTask { name });
        }
        self.groups.push(group);
        Ok(())
    }

    /// Returns the registered task group called `name`.
    ///
    /// # Errors
    /// [`EnvError::UnknownTask`], which lists the known names.
    pub fn find(&self, name: &str) -> Result<TaskGroup, EnvError> {
        self.groups.iter().copied().find(|group| group.name() == name).ok_or_else(|| {
            EnvError::UnknownTask {
                name: name.to_owned(),
                known: self.groups.iter().map(|group| group.name()).collect(),
            }
        })
    }

    /// Returns the task groups of the set called `name` ([`TaskGroup::TASK_SETS`]), registered or
    /// not, or else the registered task group of that name alone.
    ///
    /// # Errors
    /// [`EnvError::UnknownTask`], which lists the known groups.
    pub fn find_set(&self, name: &str) -> Result<Vec<TaskGroup>, EnvError> {
        match TaskGroup::TASK_SETS.into_iter().find(|(known, _)| *known == name) {
            // sets are of this crate: a program's own groups are chosen by name
            Some((_, groups)) => Ok(groups.to_vec()),
            None => Ok(vec![self.find(name)?]),
        }
    }

    /// Returns the registered task groups in the order of their registration.
    pub fn groups(&self) -> &[TaskGroup] {
        &self.groups
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::instance_id::Named;
    use crate::task::{EpisodeStart, ExpertCommand, Placement, TaskSceneParts, TaskState};
    use crate::task::{StepReward, Task};

    impl Task for Named {
        fn name(&self) -> &str {
            self.0
        }

        fn parts(&self) -> TaskSceneParts<'_> {
            TaskSceneParts::default()
        }

        fn sample_placement(&self, _: &mut ChaCha8Rng) -> Placement {
            Placement { object: DVec3::ZERO, goal: DVec3::ZERO }
        }

        fn reward(&self, _: &EpisodeStart, _: &TaskState, _: f64) -> StepReward {
            unreachable!("the registry asks for the name alone")
        }

        fn expert(&self, _: &Placement, _: &TaskState) -> ExpertCommand {
            unreachable!("the registry asks for the name alone")
        }
    }

    #[test]
    fn names_are_found_again_and_unknown_ones_list_the_known() {
        let mut registry = TaskRegistry::with_standard();
        registry.register(TaskGroup::from_task(&Named("peg-insert-2"))).unwrap();
        assert_eq!(registry.groups().len(), 5);
        for &group in registry.groups() {
            assert_eq!(registry.find(group.name()).unwrap(), group);
        }
        let message = registry.find("basketball").unwrap_err().to_string();
        let all = "goal-reach, button-press, drawer-close, plate-slide, peg-insert-2";
        assert!(message.contains("`basketball`") && message.contains(all), "{message}");
    }

    #[test]
    fn taken_and_malformed_names_are_refused() {
        let mut registry = TaskRegistry::with_standard();
        let taken = registry.register(TaskGroup::from_task(&Named("goal-reach")));
        let message = taken.unwrap_err().to_string();
        assert!(message.contains("called `goal-reach` already"), "{message}");
        for name in ["", "Peg", "peg insert", "peg_insert", "-peg", "peg--insert", "peg/.."] {
            let named: &'static Named = Box::leak(Box::new(Named(name)));
            let refused = registry.register(TaskGroup::from_task(named));
            let refusal = refused.unwrap_err().to_string();
            assert!(refusal.contains("kebab-case"), "{refusal}");
        }
        assert_eq!(registry, TaskRegistry::with_standard());
    }

    #[test]
    fn sets_hold_each_group_once_and_no_set_is_called_like_a_group() {
        let all = TaskRegistry::with_all();
        for (name, size) in [("standard", 4), ("ten", 10), ("mt10", 10), ("all", 14)] {
            let groups = all.find_set(name).unwrap();
            assert_eq!(groups.len(), size, "{name}");
            let distinct: std::collections::HashSet<_> = groups.iter().collect();
            assert_eq!(distinct.len(), size, "{name}");
            assert!(groups.iter().all(|group| all.find(group.name()).unwrap() == *group), "{name}");
            assert!(all.find(name).is_err());
        }
        assert_eq!(all.find_set("push").unwrap(), [TaskGroup::PUSH]);
        let message = all.find_set("mt50").unwrap_err().to_string();
        assert!(message.contains("`mt50`") && message.contains("peg-insert-side"), "{message}");
    }
}
