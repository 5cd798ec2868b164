//! Foreign task: a block that is pushed along +y.

pub mod spoilt;

use envs::{
    EpisodeStart, ExpertCommand, Placement, StepReward, Task, TaskSceneParts, TaskState, reward,
};
use glam::DVec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Distance from the block's start to its goal (metres).
const WAY: f64 = 0.1;
/// Remaining distance at success (metres).
const SUCCESS: f64 = 0.02;

pub const SCENE: &str = r#"
<mujocoinclude>
  <worldbody>
    <body name="object" mocap="true">
      <body name="block">
        <inertial pos="0 0 0" mass="0.2" diaginertia="2e-4 2e-4 2e-4"/>
        <joint name="push" type="slide" axis="0 1 0" range="-0.01 0.14" limited="true" damping="3"
               armature="0.001"/>
        <geom name="block" type="box" size="0.04 0.04 0.04" group="1" rgba="0.2 0.6 0.2 1"/>
      </body>
    </body>
  </worldbody>
</mujocoinclude>"#;

/// Task with a block; tests break it through the fields.
pub struct PushBlock {
    pub name: String,
    pub scene: String,
}

impl Default for PushBlock {
    fn default() -> Self {
        Self { name: "push-block".to_owned(), scene: SCENE.to_owned() }
    }
}

impl Task for PushBlock {
    fn name(&self) -> &str {
        &self.name
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        TaskSceneParts {
            mjcf: Some(&self.scene),
            object_body: Some("block"),
            ..TaskSceneParts::default()
        }
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        let object = DVec3::new(rng.random_range(0.08..0.18), 0.06, 0.045);
        Placement { object, goal: object + WAY * DVec3::Y }
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, _finger: f64) -> StepReward {
        let goal_distance = (start.placement.goal.y - now.object.y).abs();
        let approach_reward = reward::long_tail_reward(now.tcp.distance(now.object), 0.06, 0.2);
        let in_place_reward = reward::long_tail_reward(goal_distance, SUCCESS, WAY);
        StepReward {
            approach_reward,
            in_place_reward,
            goal_distance,
            reward: 10.0 * reward::hamacher_product(approach_reward, in_place_reward),
            success: goal_distance <= SUCCESS,
        }
    }

    /// Over the place behind the block, down, then forward.
    fn expert(&self, placement: &Placement, now: &TaskState) -> ExpertCommand {
        let behind = now.object - 0.07 * DVec3::Y + (now.hand - now.tcp);
        let above = now.hand.z > behind.z + 0.03;
        let hand = if now.object.y > placement.goal.y - 0.5 * SUCCESS {
            now.hand
        } else if above && (now.hand - behind).truncate().length() > 0.02 {
            behind + 0.1 * DVec3::Z
        } else if above {
            behind
        } else {
            DVec3::new(behind.x, now.hand.y + 0.02, behind.z)
        };
        ExpertCommand { hand, finger: 1.0 }
    }
}
