//! Rig without a simulation, for tests.

use std::cell::Cell;
use std::rc::Rc;
use std::time::Duration;

use envs::embodiments::{Arm, KinovaGen3};
use glam::{DQuat, DVec3};
use inpainting::{CameraCalibration, Extrinsics, Intrinsics, LensDistortion};
use rl::BoxedEnvError;
use robots::{
    ArmCommand, ControlError, KinematicArm, MissedTarget, Pose, Robot, RobotState,
    TwistControlSettings, TwistController, Watchdog,
};

use crate::rig::{PreparedTrial, Rig, TaskVerdict, Trial};

/// Function from the current time to the time of the latest picture.
pub(crate) type Camera = fn(Duration) -> Result<Duration, BoxedEnvError>;

/// Rig with a kinematic arm over a grey table, as an example of a rig of your own.
pub(crate) struct DryRig {
    pub robot: Watchdog<KinematicArm, Box<dyn Fn() -> Duration>>,
    pub clock: Rc<Cell<Duration>>,
    pub camera: Camera,
    /// `true` to panic if anything is sent to the robot.
    pub untouched: bool,
    /// `true` to refuse every command.
    pub refusing: bool,
    pub last_command: Option<ArmCommand>,
    /// Vector from the hand to where the robot reports it (metres).
    pub shift: DVec3,
    /// Angular velocity about z of the hand that the robot reports, without a command (rad/s).
    pub spin: f64,
    pub goal: DVec3,
    /// Colour (RGB) of the table when it is set up.
    pub table: [u8; 3],
}

pub(crate) fn arm() -> Arm {
    KinovaGen3.arm().unwrap()
}

pub(crate) fn dry_rig(camera: Camera) -> DryRig {
    let arm = arm();
    let start = Pose {
        position: envs::HAND_TARGET_START,
        rotation: arm.chain().tip_pose(&arm.settings().ready_joint_positions).rotation,
    };
    let posture = arm.chain().solve_ik(&start, &arm.settings().ready_joint_positions).unwrap();
    let settings = TwistControlSettings {
        limits: arm.settings().control.limits,
        ..TwistControlSettings::default()
    };
    let control = TwistController::new(arm.chain().clone(), &posture, settings).unwrap();
    let clock = Rc::new(Cell::new(Duration::ZERO));
    let time = Rc::clone(&clock);
    DryRig {
        robot: Watchdog::new(KinematicArm::new(control), Box::new(move || time.get())),
        clock,
        camera,
        untouched: false,
        refusing: false,
        last_command: None,
        shift: DVec3::ZERO,
        spin: 0.0,
        goal: DVec3::new(0.15, -0.1, 0.15),
        table: [100; 3],
    }
}

/// Returns a rig that panics if anything is sent to its robot.
pub(crate) fn untouched(camera: Camera) -> DryRig {
    DryRig { untouched: true, ..dry_rig(camera) }
}

impl Robot for DryRig {
    fn state(&mut self) -> Result<RobotState, ControlError> {
        let mut state = self.robot.state()?;
        state.tip.position += self.shift;
        let turn = DQuat::from_rotation_z(self.spin * self.clock.get().as_secs_f64());
        state.tip.rotation = turn * state.tip.rotation;
        Ok(state)
    }

    fn command(&mut self, command: &ArmCommand) -> Result<(), ControlError> {
        assert!(!self.untouched, "{command:?} was sent");
        self.last_command = Some(*command);
        if self.refusing {
            let [target, reached] = [envs::HAND_TARGET_START; 2];
            let miss = MissedTarget { target, reached, distance: 0.0, angle: 0.0, joint: None };
            return Err(ControlError::CannotFollow { miss });
        }
        self.robot.command(command)
    }

    fn stop(&mut self) -> Result<(), ControlError> {
        assert!(!self.untouched, "a stop was sent");
        self.robot.stop()
    }
}

impl Rig for DryRig {
    fn set_up(&mut self, _: &Trial) -> Result<PreparedTrial, BoxedEnvError> {
        assert!(!self.untouched, "the arm would have moved to its start");
        Ok(PreparedTrial {
            background: self.table.repeat(640 * 480),
            parked_state: self.robot.state()?,
            goal: Some(self.goal),
        })
    }

    fn calibration(&self) -> CameraCalibration {
        CameraCalibration {
            intrinsics: Intrinsics::REALSENSE_D435,
            distortion: LensDistortion::NONE,
            extrinsics: Extrinsics::overhead(1.5),
        }
    }

    fn now(&self) -> Duration {
        self.clock.get()
    }

    fn wait(&mut self, time: Duration) -> Result<(), BoxedEnvError> {
        self.robot.robot_mut().advance(time.as_secs_f64())?;
        self.clock.set(self.clock.get() + time);
        Ok(())
    }

    fn picture(&mut self, rgb: &mut [u8]) -> Result<Duration, BoxedEnvError> {
        rgb.fill(100);
        (self.camera)(self.clock.get())
    }

    fn verdict(&mut self) -> Result<TaskVerdict, BoxedEnvError> {
        assert!(!self.untouched, "nobody is to be asked");
        Ok(TaskVerdict::default())
    }
}
