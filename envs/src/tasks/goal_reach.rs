//! Goal Reach: the fingertips go to a point that the learner is told and cannot see.

use glam::DVec3;
use rand_chacha::ChaCha8Rng;

use super::{CANONICAL_X, uniform};
use crate::reward::long_tail;
use crate::scene::HAND_START;
use crate::task::{Evaluation, ExpertCommand, Measurement, Placement, Task};

/// Fingertips this near to the goal succeed (metres).
const RADIUS: f64 = 0.05;
const GOAL_Y: std::ops::Range<f64> = 0.08..0.18;
const GOAL_Z: std::ops::Range<f64> = 0.08..0.25;

/// The reach task; its scene is the bare table.
#[derive(Clone, Copy, Debug)]
pub struct GoalReach;

impl Task for GoalReach {
    fn scene(&self) -> Option<(&'static str, &'static str)> {
        None
    }

    fn object_body(&self) -> Option<&'static str> {
        None
    }

    fn object_offset(&self) -> DVec3 {
        DVec3::ZERO
    }

    fn start_joints(&self) -> &'static [(&'static str, f64)] {
        &[]
    }

    fn place(&self, rng: &mut ChaCha8Rng) -> Placement {
        let goal = DVec3::new(
            uniform(rng, CANONICAL_X),
            uniform(rng, GOAL_Y),
            uniform(rng, GOAL_Z),
        );
        Placement { object: goal, goal }
    }

    fn target(&self, placement: &Placement) -> DVec3 {
        placement.goal
    }

    fn reveals_target(&self) -> bool {
        true
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
