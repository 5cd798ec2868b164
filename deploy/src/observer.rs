//! Observations of a policy: the camera's latest picture without the arm.

use std::time::Duration;

use envs::embodiments::Arm;
use envs::{Camera, ObservationPictures};
use glam::DVec3;
use inpainting::{CameraCalibration, Perception};
use robots::RobotState;

use crate::DeployError;

use super::plausibility::check_table;
use super::rig::{MAX_PICTURE_AGE, PreparedTrial, Rig, fresh_picture};
use super::settings::VisionSettings;
use super::state_history::StateHistory;

/// Perception of a rig: removes the arm from camera pictures by the joint positions at their time.
pub(super) struct RigPerception {
    perception: Perception,
    history: StateHistory,
    /// Latest picture of the camera `[H, W, 3]`, with H rows and W columns.
    picture: Vec<u8>,
    /// Time at which the camera took `picture`.
    taken: Duration,
    /// Camera that the policy was trained with.
    camera: Camera,
    /// Last picture after removal of the arm `[rendered_size, rendered_size, 3]`.
    painted: Vec<u8>,
}

impl RigPerception {
    /// Creates the perception of a table that was set up as `set_up`, for a policy trained with
    /// `camera`. `table` `[rendered_size, rendered_size, 3]` is a picture of the empty table by
    /// that camera, and `start` the time with the arm's state.
    ///
    /// # Errors
    /// [`DeployError::Inpainting`], [`DeployError::UnknownTable`].
    pub fn new(
        settings: &VisionSettings,
        arm: &Arm,
        calibration: CameraCalibration,
        camera: &Camera,
        table: &[u8],
        set_up: &PreparedTrial,
        start: (Duration, RobotState),
    ) -> Result<Self, DeployError> {
        let parked = arm.capsules(&set_up.parked_state);
        let radii = parked.iter().map(|capsule| capsule.radius);
        let settings = settings.perception_settings(calibration, camera, radii);
        let mut perception = Perception::new(settings, table)?;
        let parked_joints = joints(arm, &set_up.parked_state);
        perception.begin_episode(&set_up.background, &parked_joints)?;
        let mut painted = vec![0; table.len()];
        // of a copy, which leaves the background as it is
        let mut copy = perception.clone();
        copy.observe(&set_up.background, &parked_joints, DVec3::ZERO, &mut painted)?;
        check_table(perception.rectified_frame(), &painted, table)?;
        Ok(Self {
            perception,
            taken: start.0,
            history: StateHistory::new(start, MAX_PICTURE_AGE),
            picture: vec![0; set_up.background.len()],
            camera: *camera,
            painted,
        })
    }

    /// Records the arm's state at the time `now`, which must not be before that of the last record.
    pub fn record_state(&mut self, now: Duration, state: RobotState) {
        self.history.record(now, state);
    }

    /// Returns the arm's last recorded state.
    pub fn last_arm_state(&self) -> &RobotState {
        self.history.last()
    }

    /// Fetches the camera's latest picture.
    ///
    /// # Errors
    /// As [`fresh_picture`].
    pub fn fetch_picture(&mut self, rig: &mut dyn Rig) -> Result<(), DeployError> {
        self.taken = fresh_picture(rig, &mut self.picture)?;
        Ok(())
    }

    /// Writes the picture last fetched into `out` `[size, size, 3]`, without the arm, and with the
    /// mark at the gripper's current position.
    ///
    /// # Errors
    /// [`DeployError::Inpainting`].
    pub fn write_picture_without_arm(
        &mut self,
        arm: &Arm,
        out: &mut [u8],
    ) -> Result<(), DeployError> {
        // pictures come late: mask the arm where it was when the picture was taken
        let joints = joints(arm, &self.history.state_at(self.taken));
        let gripper = self.last_arm_state().tip.position;
        self.perception.observe(&self.picture, &joints, gripper, &mut self.painted)?;
        self.camera.downsample(&self.painted, out);
        self.camera.draw_gripper_mark(&self.camera.mark, gripper, out);
        Ok(())
    }

    /// Returns the colour (RGB) of the mark at the gripper; `None` if none is drawn.
    pub fn mark_colour(&self) -> Option<[u8; 3]> {
        let mark = self.camera.mark;
        (mark.radius > 0.0).then_some(mark.color)
    }

    /// Composes the image of an observation, `[size, size, C]`, from the last picture of
    /// [`RigPerception::write_picture_without_arm`], `current`, and the episode's first one.
    pub fn compose_observation(&self, current: &[u8], first: &[u8], image: &mut [u8]) {
        let pictures = ObservationPictures {
            current,
            first,
            rendered: &self.painted,
            hand: self.last_arm_state().tip.position,
        };
        self.camera.compose_observation(&pictures, image);
    }

    /// Returns the camera's picture `[H, W, 3]` that was fetched last, with the arm in it.
    pub fn camera_picture(&self) -> &[u8] {
        &self.picture
    }

    /// Returns the perception, with the mask of the last
    /// [`RigPerception::write_picture_without_arm`].
    pub fn perception(&self) -> &Perception {
        &self.perception
    }
}

/// Returns the end points of the capsules that make up the arm, two for each capsule.
fn joints(arm: &Arm, state: &RobotState) -> Vec<DVec3> {
    let capsules = arm.capsules(state).into_iter();
    capsules.flat_map(|capsule| capsule.ends).collect()
}

#[cfg(test)]
mod tests;
