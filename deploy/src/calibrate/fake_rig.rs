//! Fake rig for tests: an arm that moves at once and a camera with a grey picture.

use std::time::Duration;

use envs::embodiments::Arm;
use envs::{Camera, Embodiment, HAND_TARGET_START};
use glam::{DQuat, DVec3};
use inpainting::CameraCalibration;
use rl::BoxedEnvError;
use robots::{ArmCommand, ControlError, MissedTarget, Pose, Robot, RobotState};

use crate::rig::{PreparedTrial, Rig, TaskVerdict, Trial};
use crate::{SimulatedRig, SimulatedRigSettings};

/// Fake rig for tests: an arm without dynamics over a grey table.
pub struct KinematicRig {
    pub state: RobotState,
    pub time: Duration,
    /// Angular velocity of the hand without commands (rad/s).
    pub spin: f64,
    /// Time by which the camera's clock is ahead.
    pub ahead: Duration,
}

impl KinematicRig {
    pub fn new(arm: &Arm) -> Self {
        let joints = arm.settings().ready_joint_positions.clone();
        Self {
            state: RobotState {
                tip: Pose {
                    position: HAND_TARGET_START,
                    rotation: arm.chain().tip_pose(&joints).rotation,
                },
                joints,
                gripper_closure: 0.0,
            },
            time: Duration::ZERO,
            spin: 0.0,
            ahead: Duration::ZERO,
        }
    }

    fn turn(&mut self, by: DVec3) {
        let tip = &mut self.state.tip;
        tip.rotation = (DQuat::from_scaled_axis(by) * tip.rotation).normalize();
    }
}

impl Robot for KinematicRig {
    fn state(&mut self) -> Result<RobotState, ControlError> {
        Ok(self.state.clone())
    }

    /// Moves the hand by one tick of 25 ms; heights above 0.24 m are out of reach.
    fn command(&mut self, command: &ArmCommand) -> Result<(), ControlError> {
        let tip = &mut self.state.tip;
        if command.twist.linear.z > 0.0 && tip.position.z > 0.24 {
            let [target, reached] = [tip.position; 2];
            let miss = MissedTarget { target, reached, distance: 0.1, angle: 0.0, joint: None };
            return Err(ControlError::CannotFollow { miss });
        }
        tip.position += 0.025 * command.twist.linear;
        self.turn(0.025 * command.twist.angular);
        Ok(())
    }

    fn stop(&mut self) -> Result<(), ControlError> {
        Ok(())
    }
}

impl Rig for KinematicRig {
    fn set_up(&mut self, _: &Trial) -> Result<PreparedTrial, BoxedEnvError> {
        Ok(PreparedTrial {
            background: vec![100; 3 * 640 * 480],
            parked_state: self.state.clone(),
            goal: None,
        })
    }

    fn calibration(&self) -> CameraCalibration {
        let rig = SimulatedRig::new(
            SimulatedRigSettings::NO_FAULTS,
            Camera::default(),
            Embodiment::KINOVA_GEN3,
        );
        rig.unwrap().true_calibration()
    }

    fn now(&self) -> Duration {
        self.time
    }

    fn wait(&mut self, time: Duration) -> Result<(), BoxedEnvError> {
        self.time += time;
        self.turn(self.spin * time.as_secs_f64() * DVec3::Z);
        Ok(())
    }

    fn picture(&mut self, _: &mut [u8]) -> Result<Duration, BoxedEnvError> {
        Ok(self.time + self.ahead)
    }

    fn verdict(&mut self) -> Result<TaskVerdict, BoxedEnvError> {
        Ok(TaskVerdict::default())
    }
}
