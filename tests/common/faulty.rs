//! A task of somebody else's, which may fail.

use std::sync::atomic::{AtomicUsize, Ordering};

use envs::tasks::DrawerClose;
use envs::{EpisodeStart, ExpertCommand, Placement, StepReward, Task, TaskSceneParts, TaskState};
use rand_chacha::ChaCha8Rng;

/// Drawer Close under another name, until its reward was asked for this many times; then the fault.
pub struct Faulty {
    name: &'static str,
    asked: AtomicUsize,
    after: usize,
    fault: fn() -> f64,
}

impl Faulty {
    pub const fn new(name: &'static str, after: usize, fault: fn() -> f64) -> Self {
        let asked = AtomicUsize::new(0);
        Self { name, asked, after, fault }
    }
}

impl Task for Faulty {
    fn name(&self) -> &str {
        self.name
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        DrawerClose.parts()
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        DrawerClose.sample_placement(rng)
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, finger: f64) -> StepReward {
        let mut reward = DrawerClose.reward(start, now, finger);
        if self.asked.fetch_add(1, Ordering::Relaxed) == self.after {
            reward.reward = (self.fault)();
        }
        reward
    }

    fn expert(&self, placement: &Placement, now: &TaskState) -> ExpertCommand {
        DrawerClose.expert(placement, now)
    }
}
