//! Button Press and Button Press Topdown: push a button that faces -y, or up, into its box.

use std::ops::Range;

use glam::DVec3;
use rand_chacha::ChaCha8Rng;

use super::{CANONICAL_X, META_WORLD_HAND_BACK, META_WORLD_X, draw_at, hand_for_tips, scene, spec};
use crate::mjcf::part;
use crate::reward::{hamacher_product, long_tail_reward};
use crate::task::{
    EpisodeStart, ExpertCommand, MetaWorldTaskSettings, Placement, StepReward, Task,
    TaskSceneParts, TaskState,
};

/// Task of pressing a button into its box.
#[derive(Clone, Copy, Debug)]
pub struct ButtonPress;

/// Task of pressing a button from above.
#[derive(Clone, Copy, Debug)]
pub struct ButtonPressTopdown;

/// Range of the box's centre along y (metres): nearer than Meta-World's, so that the arm reaches
/// past the pressed button.
const BOX_Y: Range<f64> = 0.22..0.27;
/// Range of the box's centre along y in Meta-World (metres).
const META_WORLD_BOX_Y: Range<f64> = 0.25..0.30;
/// Height of the box's centre, and of that of Meta-World's button which faces up (metres).
const BOX_Z: f64 = 0.115;
/// Offset from the button body's origin to the middle of its cap (metres).
const CAP: DVec3 = DVec3::new(0.0, -0.193, 0.0);
/// Offset from the box's centre to the cap's position when fully pressed (metres).
const HOLE: DVec3 = DVec3::new(0.0, -0.1, 0.0);

/// Range along y of the centre of a box whose button faces up (metres).
const TOP_BOX_Y: Range<f64> = 0.16..0.24;
/// Range along y of the centre of Meta-World's box whose button faces up (metres).
const META_WORLD_TOP_BOX_Y: Range<f64> = 0.2..0.3;
/// Height of the centre of a box whose button faces up (metres): half of it is in the table, so
/// that the hand comes over the button.
const TOP_BOX_Z: f64 = 0.0;
/// Offset from the body's origin to the middle of the cap of a button that faces up (metres).
const TOP_CAP: DVec3 = DVec3::new(0.0, 0.0, 0.193);
/// Offset from the box's centre to the cap of a button that faces up, fully pressed (metres).
const TOP_HOLE: DVec3 = DVec3::new(0.0, 0.0, 0.1);
/// [`TOP_HOLE`] in Meta-World, whose box is turned by 1.57 rather than a right angle.
const META_WORLD_TOP_HOLE: DVec3 = DVec3::new(0.0, -7.963267107332634e-5, 0.09999996829318347);

/// Figures of the reward of a press, in metres.
struct PressReward {
    /// Travel of the cap from rest to fully pressed, the margin of the pressed term.
    travel: f64,
    /// Remaining travel at success.
    success: f64,
    /// Distance of the fingertips from the cap at full reward.
    reached: f64,
    /// Distance of the fingertips from the cap within which a press counts.
    touching: f64,
    /// Weights of reaching the cap and of pressing it, which sum to 10.
    weights: [f64; 2],
}

const PRESS: PressReward = PressReward {
    travel: 0.0935,
    success: 0.02,
    reached: 0.05,
    touching: 0.05,
    weights: [2.0, 8.0],
};
const TOP_PRESS: PressReward = PressReward {
    // 0.0935 turned by 1.57
    travel: 0.09349997035412654,
    success: 0.024,
    reached: 0.01,
    touching: 0.03,
    weights: [5.0, 5.0],
};
/// Remaining travel at full reward (metres).
const PRESSED: f64 = 0.005;
/// Offset of the hand from its line to the cap from which the expert begins to press (metres).
const IN_LINE: f64 = 0.02;
/// Distance beyond the cap that the expert aims at (metres): the hand's target must run ahead of
/// the hand for it to push.
const THROUGH: f64 = 0.1;

impl Task for ButtonPress {
    fn name(&self) -> &str {
        "button-press"
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        place(draw_at(BOX_Z, [CANONICAL_X, BOX_Y], rng), HOLE)
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, _: f64) -> StepReward {
        PRESS.of(start, now, (start.placement.goal.y - now.object.y).abs(), now.aperture)
    }

    /// Goes in front of the cap, well clear of it, then straight through.
    fn expert(&self, _: &Placement, now: &TaskState) -> ExpertCommand {
        let aim = hand_for_tips(now, now.object);
        let off_axis = (now.hand.x - aim.x).abs().max((now.hand.z - aim.z).abs());
        let hand = if off_axis > IN_LINE {
            // sideways only in front of the cap, which a finger might press askew
            DVec3::new(aim.x, now.hand.y.min(aim.y - 0.1), aim.z)
        } else {
            aim + THROUGH * DVec3::Y
        };
        ExpertCommand { hand, finger: 0.0 }
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        scene(part!("button_press.xml").1, "button", CAP)
    }

    fn meta_world_settings(&self) -> Option<MetaWorldTaskSettings<'_>> {
        Some(MetaWorldTaskSettings {
            hand_target: META_WORLD_HAND_BACK,
            // its reset presses the button to the end of its joint, from where a spring frees it
            start_joints: &[("press", 0.0)],
            ..spec("button-press", |rng| {
                place(draw_at(BOX_Z, [META_WORLD_X, META_WORLD_BOX_Y], rng), HOLE)
            })
        })
    }
}

impl Task for ButtonPressTopdown {
    fn name(&self) -> &str {
        "button-press-topdown"
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        place(draw_at(TOP_BOX_Z, [CANONICAL_X, TOP_BOX_Y], rng), TOP_HOLE)
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, _: f64) -> StepReward {
        let goal_distance = (start.placement.goal.z - now.object.z).abs();
        // closed fingers earn more here: an open claw would come down beside the cap
        TOP_PRESS.of(start, now, goal_distance, 1.0 - now.aperture)
    }

    /// Goes over the cap with closed fingers, then straight down.
    fn expert(&self, _: &Placement, now: &TaskState) -> ExpertCommand {
        let aim = hand_for_tips(now, now.object);
        let hand = if (now.hand - aim).truncate().length() > IN_LINE {
            // sideways only above the cap
            DVec3::new(aim.x, aim.y, now.hand.z.max(aim.z + 0.05))
        } else {
            aim - THROUGH * DVec3::Z
        };
        ExpertCommand { hand, finger: 1.0 }
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        scene(part!("button_press_topdown.xml").1, "button", TOP_CAP)
    }

    fn meta_world_settings(&self) -> Option<MetaWorldTaskSettings<'_>> {
        Some(MetaWorldTaskSettings {
            hand_target: META_WORLD_HAND_BACK,
            ..spec("button-press-topdown", |rng| {
                let object = draw_at(BOX_Z, [META_WORLD_X, META_WORLD_TOP_BOX_Y], rng);
                place(object, META_WORLD_TOP_HOLE)
            })
        })
    }
}

fn place(object: DVec3, hole: DVec3) -> Placement {
    Placement { object, goal: object + hole }
}

impl PressReward {
    /// Returns the reward of a cap that is `goal_distance` (metres) from fully pressed, with the
    /// fingers' own term `fingers` in `[0, 1]`.
    fn of(
        &self,
        start: &EpisodeStart,
        now: &TaskState,
        goal_distance: f64,
        fingers: f64,
    ) -> StepReward {
        let distance = now.object.distance(now.tcp);
        // as in Meta-World, the margin is the cap's present distance from the fingertips' start
        let margin = now.object.distance(start.task_state.tcp);
        let near = long_tail_reward(distance, self.reached, margin);
        let pressed = long_tail_reward(goal_distance, PRESSED, self.travel);
        let touching = if distance <= self.touching { 1.0 } else { 0.0 };
        let [reaching, pressing] = self.weights;
        StepReward {
            approach_reward: near,
            in_place_reward: pressed,
            goal_distance,
            reward: reaching * hamacher_product(fingers, near) + pressing * pressed * touching,
            success: goal_distance <= self.success,
        }
    }
}
