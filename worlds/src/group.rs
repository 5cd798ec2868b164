//! Task groups: the object, the reward and the dynamics that all tasks of one group share.

use crate::appearance::Appearance;

/// Task group of a world: all variants of D2 and all placements of one object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TaskGroup {
    /// Appearance of the group's object at the beginning of the stream of tasks.
    pub appearance: Appearance,
    /// Reward function of the group.
    pub reward: RewardFunction,
    /// Dynamics of the hand in the group.
    pub dynamics: HandDynamics,
    /// Levels, of 255, that the group adds to each channel of the ground's colour.
    pub ground_tint: [f32; 3],
    /// Signed amplitude of each colour's drift, a sine with a period of 1000 rounds, in units of a
    /// byte; zero without drift.
    pub colour_drift: [f32; 3],
}

/// Reward of a step, before the scale of the scene: `exp(-10 d)`, where d is the distance of the
/// hand from a circle around a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RewardFunction {
    /// Vector from the object to the target, in units of half the picture's side.
    pub offset: [f32; 2],
    /// Radius of the circle of full reward, in units of half the picture's side; with zero the
    /// target itself has the full reward.
    pub radius: f32,
}

/// Decay rate of the reward with distance, per half of the picture's side.
const DECAY: f32 = 10.0;

impl RewardFunction {
    /// Returns the reward, in (0, 1], for a hand at a position relative to the object, in units of
    /// half the picture's side.
    pub fn reward_at(&self, [x, y]: [f32; 2]) -> f32 {
        (-DECAY * self.distance_to_target_circle([x, y])).exp()
    }

    /// Returns the distance of a hand, at a position relative to the object, from the nearest
    /// position of full reward, in units of half the picture's side.
    pub fn distance_to_target_circle(&self, [x, y]: [f32; 2]) -> f32 {
        ((x - self.offset[0]).hypot(y - self.offset[1]) - self.radius).abs()
    }

    /// Returns the vector from a position of the hand, relative to the object, to the nearest
    /// position of full reward.
    pub(crate) fn vector_to_target_circle(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let (dx, dy) = (self.offset[0] - x, self.offset[1] - y);
        // no division by zero for a hand at the target
        let distance = dx.hypot(dy).max(1e-6);
        let share = 1.0 - self.radius / distance;
        [dx * share, dy * share]
    }
}

/// Dynamics of the hand: the displacement that an action in `[-1, 1]^2` causes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandDynamics {
    /// Displacement at full action, in units of half the picture's side; reversed if negative.
    pub gain: f32,
    /// Angle from an action's direction to that of the displacement, in radians.
    pub rotation_rad: f32,
}

impl HandDynamics {
    /// Returns the hand's displacement under an action, in units of half the picture's side.
    pub(crate) fn displacement(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let (sin, cos) = self.rotation_rad.sin_cos();
        [self.gain * (cos * x - sin * y), self.gain * (sin * x + cos * y)]
    }

    /// Returns the action that causes a displacement of the hand; it may lie outside `[-1, 1]^2`.
    pub(crate) fn action_for_displacement(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let (sin, cos) = self.rotation_rad.sin_cos();
        [(cos * x + sin * y) / self.gain, (cos * y - sin * x) / self.gain]
    }
}

/// Period of the drift of objects' colours, in rounds (episodes in each environment).
const PERIOD: f32 = 1000.0;

impl TaskGroup {
    /// Returns the group with the colours that its object has drifted to after `rounds` rounds.
    pub(crate) fn after(mut self, rounds: usize) -> Self {
        let share = (std::f32::consts::TAU * rounds as f32 / PERIOD).sin();
        for (colour, drift) in self.appearance.colour.iter_mut().zip(self.colour_drift) {
            *colour += share * drift;
        }
        self
    }
}
