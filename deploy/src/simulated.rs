//! Simulated rig: an arm behind the interface of a real one, and a camera with the faults of a real
//! one.

use std::cell::Cell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use envs::embodiments::{Arm, ArmSettings};
use envs::mujoco::State;
use envs::{
    Camera, ControlSettings, Embodiment, EnvError, RGB_CHANNELS, Scene, SceneRenderer,
    SimulatedArm, TableTop, TaskGroup,
};
use glam::DVec3;
use inpainting::{
    CameraCalibration, CameraImperfections, Extrinsics, Intrinsics, LensDistortion, SimulatedCamera,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::BoxedEnvError;
use robots::{ArmCommand, ControlError, LinkMjcfAddition, Robot, RobotState, Watchdog};

use crate::DeployError;

use super::rig::{PreparedTrial, Rig, TaskVerdict, Trial};

/// Faults of the camera and the arm of a simulated rig.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedRigSettings {
    /// Faults of the simulated camera.
    pub camera_imperfections: CameraImperfections,
    /// Delay from a command to its effect (seconds).
    pub command_latency_s: f64,
}

impl SimulatedRigSettings {
    /// Perfect camera and an arm without delay.
    pub const NO_FAULTS: Self = Self {
        camera_imperfections: CameraImperfections::NO_IMPERFECTIONS,
        command_latency_s: 0.0,
    };
    /// Camera with the faults of real ones, and an arm with the delay of one cycle at 40 Hz.
    pub const NOMINAL_FAULTS: Self = Self {
        camera_imperfections: CameraImperfections::REALSENSE_D435,
        command_latency_s: 0.025,
    };
}

type Watched = Watchdog<SimulatedArm, Box<dyn Fn() -> Duration>>;

const STEP: Duration = Duration::from_micros(12_500);
/// Number of control steps whose states are kept to render late pictures: 2.25 s, more than the
/// largest latency and exposure time of a camera.
const KEPT: usize = 180;
/// Bit in the number of a random stream that tells streams of cameras from those of placements,
/// which are the numbers of the trials.
const CAMERAS: u64 = 1 << 63;

/// Position of the magenta calibration ball of 40 mm (metres), from the tip of the hand in the
/// world's axes while the hand has its working orientation: on a rod in front of the wrist, where
/// no part of the arm hides it from the camera above.
const BALL: DVec3 = DVec3::new(0.0, 0.13, 0.17);

/// Simulated arm at its table, under a camera.
pub struct SimulatedRig {
    settings: SimulatedRigSettings,
    /// Camera of the policy's training. The rig's camera has the same light and the same pose.
    policy: Camera,
    arm: Arm,
    embodiment: Embodiment,
    clock: Rc<Cell<Duration>>,
    workspace: Option<Workspace>,
    verdict: TaskVerdict,
}

/// Simulation of the table, the arm and the camera for one task group.
struct Workspace {
    group: TaskGroup,
    robot: Watched,
    camera: SimulatedCamera,
    renderer: SceneRenderer,
    /// Copy of the simulated table that is set to past states, or to a parked arm, and rendered.
    ghost: TableTop,
    /// Simulation state after each of the last control steps, oldest first.
    history: VecDeque<(Duration, State)>,
    /// Pictures of a perfect camera at the end and at the beginning of the exposure.
    ideal: [Vec<u8>; 2],
}

impl SimulatedRig {
    /// Creates a simulated rig with the arm `robot`, whose camera has the light and the pose of
    /// `policy`, the camera of the policies' training.
    ///
    /// # Errors
    /// [`EnvError::InvalidSetting`] for an embodiment without servos, and errors of reading an
    /// arm's file.
    pub fn new(
        settings: SimulatedRigSettings,
        policy: Camera,
        robot: Embodiment,
    ) -> Result<Self, DeployError> {
        Ok(Self::of(settings, policy, robot.arm()?.clone(), robot))
    }

    /// Creates a simulated rig whose arm carries the magenta ball that `covers calibrate` looks for
    /// by default.
    ///
    /// # Errors
    /// As [`SimulatedRig::new`].
    pub fn new_with_calibration_ball(
        settings: SimulatedRigSettings,
        policy: Camera,
        robot: Embodiment,
    ) -> Result<Self, DeployError> {
        let arm = carrying_ball(robot)?;
        Ok(Self::of(settings, policy, arm.clone(), Embodiment::from_spec(arm)))
    }

    fn of(
        settings: SimulatedRigSettings,
        policy: Camera,
        arm: Arm,
        embodiment: Embodiment,
    ) -> Self {
        Self {
            settings,
            policy,
            arm,
            embodiment,
            clock: Rc::default(),
            workspace: None,
            verdict: TaskVerdict::default(),
        }
    }

    /// Returns the model of the rig's arm.
    pub fn arm(&self) -> &Arm {
        &self.arm
    }

    /// Returns the true pose and intrinsics of the simulated camera, as a calibration without lens
    /// distortion.
    pub fn true_calibration(&self) -> CameraCalibration {
        CameraCalibration {
            intrinsics: Intrinsics::REALSENSE_D435,
            distortion: LensDistortion::NONE,
            extrinsics: Extrinsics::overhead(self.policy.height),
        }
    }

    fn workspace(&mut self) -> Result<&mut Workspace, ControlError> {
        self.workspace
            .as_mut()
            .ok_or_else(|| ControlError::Driver { source: Box::new(EnvError::NotReset) })
    }

    /// Creates the camera of one trial. Each trial has its own errors of the calibration.
    fn camera(&self, trial: &Trial) -> Result<SimulatedCamera, DeployError> {
        let mut rng = ChaCha8Rng::seed_from_u64(trial.seed);
        rng.set_stream(camera_stream(trial));
        Ok(SimulatedCamera::new(self.true_calibration(), self.settings.camera_imperfections, rng)?)
    }

    /// Builds the simulation of a group, drawn by a perfect camera with the field of view of
    /// `camera`.
    fn compile(&self, group: TaskGroup, camera: SimulatedCamera) -> Result<Workspace, DeployError> {
        let inside = camera.ideal_camera().intrinsics;
        // the perfect camera is square: half its width in pixels gives what it sees of the table
        let half = inside.width as f64 / 2.0;
        let seen = Camera {
            half_extent: half * self.policy.height / inside.focal_lengths[0],
            ..self.policy.with_size(inside.width)
        };
        let scene = Arc::new(Scene::new(group, self.embodiment, seen)?);
        let arm = SimulatedArm::new(Arc::clone(&scene), self.settings.command_latency_s)?;
        let clock = Rc::clone(&self.clock);
        let time: Box<dyn Fn() -> Duration> = Box::new(move || clock.get());
        let pixels = vec![0; inside.width * inside.width * RGB_CHANNELS];
        Ok(Workspace {
            group,
            robot: Watchdog::new(arm, time),
            renderer: SceneRenderer::with_arm(Arc::clone(&scene))?,
            ghost: TableTop::new(scene, ControlSettings::default())?,
            history: VecDeque::new(),
            ideal: [pixels.clone(), pixels],
            camera,
        })
    }

    fn set(&mut self, trial: &Trial) -> Result<PreparedTrial, DeployError> {
        let camera = self.camera(trial)?;
        let group = trial.variant.group;
        // compiling a scene is slow, so trials of one group share it
        let kept = self.workspace.take().filter(|workspace| workspace.group == group);
        let mut workspace = match kept {
            Some(workspace) => Workspace { camera, ..workspace },
            None => self.compile(group, camera)?,
        };
        let mut rng = ChaCha8Rng::seed_from_u64(trial.seed);
        rng.set_stream(trial.index as u64);
        let placement = workspace.ghost.scene().sample_placement(&mut rng);
        let element = trial.variant.element;
        workspace.robot.robot_mut().start_episode(element, placement)?;
        workspace.ghost.reset_to(element, placement)?;
        // late pictures must not show the last trial
        workspace.history.clear();
        let parked = parked(&self.arm);
        let background = workspace.parked_picture(&self.arm, &parked, self.clock.get())?;
        workspace.remember(self.clock.get());
        let goal = workspace.ghost.observable_goal();
        self.workspace = Some(workspace);
        self.verdict = TaskVerdict::default();
        Ok(PreparedTrial { background, parked_state: parked, goal })
    }

    /// Simulates one control step and checks the watchdog.
    fn advance(&mut self) -> Result<(), DeployError> {
        let now = self.clock.get() + STEP;
        let workspace = self.workspace()?;
        let outcome = workspace.robot.robot_mut().advance()?;
        workspace.remember(now);
        self.clock.set(now);
        let verdict = &mut self.verdict;
        verdict.success |= outcome.success;
        verdict.success_at_end = outcome.success;
        self.workspace()?.robot.stop_if_timed_out()?;
        Ok(())
    }
}

impl Workspace {
    /// Stores the current state of the simulation, and drops the oldest one if there are too many.
    fn remember(&mut self, now: Duration) {
        let state = self.robot.robot().environment().simulation().save_state();
        self.history.push_back((now, state));
        if self.history.len() > KEPT {
            self.history.pop_front();
        }
    }

    /// Renders the perfect camera's picture at a time, or at the first known state, into
    /// `ideal[which]`.
    fn draw(&mut self, time: Duration, which: usize) -> Result<(), EnvError> {
        // the last state that is not later than `time`
        let after = self.history.partition_point(|(then, _)| *then <= time);
        let found = self.history.get(after.saturating_sub(1));
        let (_, state) = found.ok_or(EnvError::NotReset)?;
        let simulation = self.ghost.simulation_mut();
        simulation.restore_state(state)?;
        simulation.forward_kinematics()?;
        self.renderer.render(&mut self.ghost, &mut self.ideal[which])
    }

    /// Returns the simulated camera's picture of the table with the arm parked.
    fn parked_picture(
        &mut self,
        arm: &Arm,
        parked: &RobotState,
        now: Duration,
    ) -> Result<Vec<u8>, DeployError> {
        let simulation = self.ghost.simulation_mut();
        for (joint, position) in arm.chain().joints().iter().zip(&parked.joints) {
            let model = simulation.model();
            let address =
                model.joint_qpos_address(model.joint(&joint.name).map_err(EnvError::from)?);
            simulation.qpos_mut()[address] = *position;
        }
        simulation.forward_kinematics().map_err(EnvError::from)?;
        self.renderer.render(&mut self.ghost, &mut self.ideal[0])?;
        self.shoot(1, now)
    }

    /// Returns the simulated camera's picture, from the first `instants` pictures of the perfect
    /// one.
    fn shoot(&mut self, instants: usize, now: Duration) -> Result<Vec<u8>, DeployError> {
        let Intrinsics { width, height, .. } = self.camera.reported_calibration().intrinsics;
        let mut rgb = vec![0; width * height * RGB_CHANNELS];
        let ideal = self.ideal.each_ref().map(|picture| &picture[..]);
        self.camera.take_picture(&ideal[..instants], now.as_secs_f64(), &mut rgb)?;
        Ok(rgb)
    }

    /// Returns the simulated camera's latest picture and the middle of its exposure time.
    fn picture(&mut self, now: Duration) -> Result<(Vec<u8>, Duration), DeployError> {
        let imperfections = *self.camera.imperfections();
        let of = Duration::from_secs_f64;
        let end = now.saturating_sub(of(imperfections.latency));
        let begin = end.saturating_sub(of(imperfections.exposure_time));
        self.draw(end, 0)?;
        let blurred = begin < end;
        if blurred {
            self.draw(begin, 1)?;
        }
        let picture = self.shoot(if blurred { 2 } else { 1 }, now)?;
        Ok((picture, begin + (end - begin) / 2))
    }
}

/// Returns the random stream of a trial's camera. Each trial of each variant has its own.
fn camera_stream(trial: &Trial) -> u64 {
    let variant = trial.variant.to_string();
    // FNV-1a (Fowler, Noll and Vo): unlike the standard library's hash, it never changes
    let name = variant.bytes().fold(0xcbf2_9ce4_8422_2325, |hash: u64, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    CAMERAS | name.wrapping_add(trial.index as u64)
}

/// Returns the arm of a robot with its ball, which is built once per process.
fn carrying_ball(robot: Embodiment) -> Result<&'static Arm, DeployError> {
    static ARMS: Mutex<Vec<(Embodiment, &'static Arm)>> = Mutex::new(Vec::new());
    let mut arms = ARMS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, arm)) = arms.iter().find(|(of, _)| *of == robot) {
        return Ok(arm);
    }
    let bare = robot.arm()?;
    let settings = bare.settings();
    let working = bare.chain().tip_pose(&settings.ready_joint_positions).rotation;
    let DVec3 { x, y, z } = working.conjugate() * BALL;
    let ball = LinkMjcfAddition {
        link: settings.hand_link.clone(),
        mjcf: format!(
            r#"<geom name="ball" type="sphere" size="0.02" pos="{x} {y} {z}" mass="0" rgba="1 0 1 1"/>"#
        ),
    };
    let arm = Arm::new(ArmSettings {
        name: "arm_with_ball".to_owned(),
        additions: vec![ball],
        ..settings.clone()
    })?;
    let arm: &'static Arm = Box::leak(Box::new(arm));
    arms.push((robot, arm));
    Ok(arm)
}

/// Returns the state of the arm turned away from the table by half a turn about its base.
fn parked(arm: &Arm) -> RobotState {
    let mut joints = arm.settings().ready_joint_positions.clone();
    if let Some(pan) = joints.first_mut() {
        *pan += std::f64::consts::PI;
    }
    RobotState { tip: arm.chain().tip_pose(&joints), joints, gripper_closure: 0.0 }
}

impl Robot for SimulatedRig {
    fn state(&mut self) -> Result<RobotState, ControlError> {
        self.workspace()?.robot.state()
    }

    fn command(&mut self, command: &ArmCommand) -> Result<(), ControlError> {
        self.workspace()?.robot.command(command)
    }

    fn stop(&mut self) -> Result<(), ControlError> {
        match &mut self.workspace {
            Some(workspace) => workspace.robot.stop(),
            // before the first set-up there is no robot that could move
            None => Ok(()),
        }
    }
}

impl Rig for SimulatedRig {
    fn set_up(&mut self, trial: &Trial) -> Result<PreparedTrial, BoxedEnvError> {
        Ok(self.set(trial)?)
    }

    /// Returns the trial's calibration with its errors; before the first trial, the true one.
    fn calibration(&self) -> CameraCalibration {
        let workspace = self.workspace.as_ref();
        workspace.map_or_else(
            || self.true_calibration(),
            |workspace| *workspace.camera.reported_calibration(),
        )
    }

    /// Returns the true calibration, without the errors that each trial draws.
    fn trial_independent_calibration(&self) -> CameraCalibration {
        self.true_calibration()
    }

    fn now(&self) -> Duration {
        self.clock.get()
    }

    fn wait(&mut self, time: Duration) -> Result<(), BoxedEnvError> {
        let steps = time.as_secs_f64() / STEP.as_secs_f64();
        for _ in 0..steps.round() as usize {
            self.advance()?;
        }
        Ok(())
    }

    fn picture(&mut self, rgb: &mut [u8]) -> Result<Duration, BoxedEnvError> {
        let now = self.clock.get();
        let (picture, taken) = self.workspace()?.picture(now)?;
        rgb.copy_from_slice(&picture);
        Ok(taken)
    }

    fn verdict(&mut self) -> Result<TaskVerdict, BoxedEnvError> {
        Ok(std::mem::take(&mut self.verdict))
    }
}
