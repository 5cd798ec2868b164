//! Correct task with one thing changed.

use envs::{
    EpisodeStart, ExpertCommand, MetaWorldTaskSettings, Placement, StepReward, Task, TaskGroup,
    TaskSceneParts, TaskState,
};
use rand_chacha::ChaCha8Rng;

use crate::common::PushBlock;

pub type Reward = fn(&mut StepReward, &EpisodeStart, &TaskState, f64);

/// Functions that change what the correct task returns.
pub struct Spoilt {
    pub task: PushBlock,
    pub parts: fn(&mut TaskSceneParts<'_>),
    pub place: fn(&mut Placement),
    pub reward: Reward,
    pub expert: fn(&mut ExpertCommand, &TaskState),
    pub meta_world: Option<MetaWorldTaskSettings<'static>>,
}

impl Default for Spoilt {
    fn default() -> Self {
        Self {
            task: PushBlock::default(),
            parts: |_| {},
            place: |_| {},
            reward: |_, _, _, _| {},
            expert: |_, _| {},
            meta_world: None,
        }
    }
}

impl Spoilt {
    pub fn group(self) -> TaskGroup {
        TaskGroup::from_task(Box::leak(Box::new(self)))
    }
}

impl Task for Spoilt {
    fn name(&self) -> &str {
        self.task.name()
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        let mut parts = self.task.parts();
        (self.parts)(&mut parts);
        parts
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        let mut placement = self.task.sample_placement(rng);
        (self.place)(&mut placement);
        placement
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, finger: f64) -> StepReward {
        let mut reward = self.task.reward(start, now, finger);
        (self.reward)(&mut reward, start, now, finger);
        reward
    }

    fn expert(&self, placement: &Placement, now: &TaskState) -> ExpertCommand {
        let mut command = self.task.expert(placement, now);
        (self.expert)(&mut command, now);
        command
    }

    fn meta_world_settings(&self) -> Option<MetaWorldTaskSettings<'_>> {
        self.meta_world
    }
}
