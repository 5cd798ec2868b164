//! What the policy sees: the camera's newest picture with the arm painted out where it was then.

use std::time::Duration;

use envs::carriers::Arm;
use envs::{Camera, Pictures};
use glam::DVec3;
use inpainting::{Calibration, Perception};
use robots::RobotState;

use crate::DeployError;

use super::past::Past;
use super::rig::{OLDEST, Rig, SetUp, fresh_picture};
use super::settings::SightSettings;

/// The perception of an arm that tells where its joints are.
pub(super) struct Sight {
    perception: Perception,
    past: Past,
    picture: Vec<u8>,
    /// When it was taken.
    taken: Duration,
    /// The one that the policy has learnt with.
    camera: Camera,
    /// The table without the arm `[drawn_size, drawn_size, 3]`, as it was painted last.
    painted: Vec<u8>,
}

impl Sight {
    /// Sees a table that was set as `set_up` says. `table` `[drawn_size, drawn_size, 3]` is the empty
    /// table as a policy knows it that has learnt with `camera`. `start` is the time, and where the
    /// arm is.
    pub fn new(
        settings: &SightSettings,
        arm: &Arm,
        calibration: Calibration,
        (camera, table): (&Camera, &[u8]),
        set_up: &SetUp,
        start: (Duration, RobotState),
    ) -> Result<Self, DeployError> {
        let parked = arm.capsules(&set_up.parked);
        let radii = parked.iter().map(|capsule| capsule.radius);
        let settings = settings.perception(calibration, camera, radii);
        let mut perception = Perception::new(settings, table)?;
        perception.begin(&set_up.background, &joints(arm, &set_up.parked))?;
        Ok(Self {
            perception,
            taken: start.0,
            past: Past::new(start, OLDEST),
            picture: vec![0; set_up.background.len()],
            camera: *camera,
            painted: vec![0; table.len()],
        })
    }

    /// Takes note of where the arm is at the time `now`, which does not go back.
    pub fn note(&mut self, now: Duration, state: RobotState) {
        self.past.note(now, state);
    }

    /// Where the arm was noted last.
    pub fn state(&self) -> &RobotState {
        self.past.last()
    }

    /// Takes a picture.
    pub fn shoot(&mut self, rig: &mut dyn Rig) -> Result<(), DeployError> {
        self.taken = fresh_picture(rig, &mut self.picture)?;
        Ok(())
    }

    /// Writes into `out` `[size, size, 3]` what the policy sees of the picture, with the mark where
    /// the gripper is now.
    pub fn paint(&mut self, arm: &Arm, out: &mut [u8]) -> Result<(), DeployError> {
        let joints = joints(arm, &self.past.at(self.taken));
        let gripper = self.state().tip.position;
        self.perception.look(&self.picture, &joints, gripper, &mut self.painted)?;
        self.camera.shrink(&self.painted, out);
        self.camera.draw_mark(&self.camera.mark, gripper, out);
        Ok(())
    }

    /// Makes the image of an observation, `[size, size, C]`, of the picture that was painted last,
    /// `now`, and the episode's first one.
    pub fn compose(&self, now: &[u8], first: &[u8], image: &mut [u8]) {
        let pictures =
            Pictures { now, first, drawn: &self.painted, hand: self.state().tip.position };
        self.camera.compose(&pictures, image);
    }

    /// The camera's last picture `[H, W, 3]`.
    pub fn picture(&self) -> &[u8] {
        &self.picture
    }

    /// The perception, for its mask.
    pub fn perception(&self) -> &Perception {
        &self.perception
    }
}

/// Ends of the arm's capsules, two for each.
fn joints(arm: &Arm, state: &RobotState) -> Vec<DVec3> {
    let capsules = arm.capsules(state).into_iter();
    capsules.flat_map(|capsule| capsule.ends).collect()
}

#[cfg(test)]
mod tests;
