//! Goal Reach: the fingertips go to a point that the learner is told and cannot see.

use glam::DVec3;
use rand_chacha::ChaCha8Rng;

use super::{CANONICAL_X, uniform};
use crate::reward::long_tail;
use crate::scene::HAND_START;
use crate::task::{Evaluation, ExpertCommand, Measurement, Parts, Placement, Task};

/// Fingertips this near to the goal succeed (metres).
const RADIUS: f64 = 0.05;
const GOAL_Y: std::ops::Range<f64> = 0.08..0.18;
const GOAL_Z: std::ops::Range<f64> = 0.08..0.25;

const PARTS: Parts = Parts {
    scene: None,
    object_body: None,
    object_offset: DVec3::ZERO,
    start_joints: &[],
    tells_goal: true,
};

/// The reach task; its scene is the bare table.
#[derive(Clone, Copy, Debug)]
pub struct GoalReach;

impl Task for GoalReach {
    fn parts(&self) -> &'static Parts {
        &PARTS
    }

    fn place(&self, rng: &mut ChaCha8Rng) -> Placement {
        let goal = DVec3::new(
            uniform(rng, CANONICAL_X),
            uniform(rng, GOAL_Y),
            uniform(rng, GOAL_Z),
        );
        Placement { object: goal, goal }
    }

    fn evaluate(
        &self,
        placement: &Placement,
        _: &Measurement,
        now: &Measurement,
        _: f64,
    ) -> Evaluation {
        let distance = now.tcp.distance(placement.goal);
        let margin = HAND_START.distance(placement.goal);
        Evaluation {
            reward: 10.0 * long_tail(distance, RADIUS, margin),
            success: distance <= RADIUS,
        }
    }

    fn expert(&self, placement: &Placement, now: &Measurement) -> ExpertCommand {
        ExpertCommand {
            hand: placement.goal + (now.hand - now.tcp),
            finger: 0.0,
        }
    }
}
