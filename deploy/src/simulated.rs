//! A rig in simulation: an arm behind the interface of a real one, and a camera with a real one's
//! faults.

use std::cell::Cell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use envs::carriers::{Arm, ArmSettings, KinovaGen3};
use envs::mujoco::State;
use envs::{
    Camera, Control, Embodiment, EnvError, RGB, Scene, SceneRenderer, SimulatedArm, TableTop,
    TaskGroup,
};
use glam::DVec3;
use inpainting::{Calibration, Distortion, Extrinsics, Imperfections, Intrinsics, SimulatedCamera};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::BoxError;
use robots::{Addition, Command, ControlError, Robot, RobotState, Watchdog};

use crate::DeployError;

use super::rig::{Rig, SetUp, Trial, Verdict};

/// What is wrong with a simulated rig.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulationSettings {
    /// The camera's faults.
    pub imperfections: Imperfections,
    /// From a command to its effect (seconds).
    pub command_latency: f64,
}

impl SimulationSettings {
    /// A camera and an arm that do at once what they should.
    pub const OFF: Self = Self { imperfections: Imperfections::OFF, command_latency: 0.0 };
    /// A camera as real ones are, and an arm that takes a cycle of 40 Hz to obey.
    pub const NOMINAL: Self =
        Self { imperfections: Imperfections::NOMINAL, command_latency: 0.025 };
}

type Watched = Watchdog<SimulatedArm, Box<dyn Fn() -> Duration>>;

/// A control step of the simulation.
const STEP: Duration = Duration::from_micros(12_500);
/// How long the past is kept, for pictures that come late.
const KEPT: usize = 180;
/// Random streams: placements take the number of the trial, which is below this; streams of cameras
/// have this bit.
const CAMERAS: u64 = 1 << 63;

/// Where the arm carries a ball of 40 mm in magenta, from the tip of its hand, with the axes of the
/// world where the hand is turned as it works (metres): on a rod before the wrist, where nothing of
/// the arm is above it.
const BALL: DVec3 = DVec3::new(0.0, 0.13, 0.17);

/// A simulated Kinova Gen3 at its table, under a camera.
pub struct SimulatedRig {
    settings: SimulationSettings,
    /// How the policy's camera is lit, and where it hangs; this rig's hangs there, too.
    policy: Camera,
    arm: Arm,
    embodiment: Embodiment,
    clock: Rc<Cell<Duration>>,
    table: Option<Table>,
    verdict: Verdict,
}

/// What changes with the task.
struct Table {
    group: TaskGroup,
    robot: Watched,
    camera: SimulatedCamera,
    renderer: SceneRenderer,
    /// A copy of the scene that is drawn in the past, and with its arm parked.
    ghost: TableTop,
    /// The simulation after each of the last control steps, oldest first.
    past: VecDeque<(Duration, State)>,
    ideal: [Vec<u8>; 2],
}

impl SimulatedRig {
    /// A rig for policies that have learnt with the camera `policy`.
    ///
    /// # Errors
    /// None but those of an arm that the crate's tests make.
    pub fn new(settings: SimulationSettings, policy: Camera) -> Result<Self, DeployError> {
        Ok(Self::of(settings, policy, KinovaGen3.arm()?, Embodiment::KINOVA_GEN3))
    }

    /// A rig whose arm carries a ball in magenta that `covers calibrate` looks for.
    ///
    /// # Errors
    /// As [`SimulatedRig::new`].
    pub fn with_ball(settings: SimulationSettings, policy: Camera) -> Result<Self, DeployError> {
        let arm = carrying_ball()?;
        Ok(Self::of(settings, policy, arm.clone(), Embodiment::of(arm)))
    }

    fn of(settings: SimulationSettings, policy: Camera, arm: Arm, embodiment: Embodiment) -> Self {
        Self {
            settings,
            policy,
            arm,
            embodiment,
            clock: Rc::default(),
            table: None,
            verdict: Verdict::default(),
        }
    }

    /// What is known of its arm.
    pub fn arm(&self) -> &Arm {
        &self.arm
    }

    /// The camera as it is, but for the distortion that nobody knows.
    pub fn truth(&self) -> Calibration {
        Calibration {
            intrinsics: Intrinsics::REALSENSE_D435,
            distortion: Distortion::NONE,
            extrinsics: Extrinsics::overhead(self.policy.height),
        }
    }

    fn table(&mut self) -> Result<&mut Table, ControlError> {
        self.table
            .as_mut()
            .ok_or_else(|| ControlError::Driver { source: Box::new(EnvError::NotReset) })
    }

    /// A camera for one trial: each is calibrated anew, and wrong in its own way.
    fn camera(&self, trial: &Trial) -> Result<SimulatedCamera, DeployError> {
        let mut rng = ChaCha8Rng::seed_from_u64(trial.seed);
        rng.set_stream(camera_stream(trial));
        Ok(SimulatedCamera::new(self.truth(), self.settings.imperfections, rng)?)
    }

    /// The scene of a group, drawn by a perfect camera with the lens of `camera`.
    fn compile(&self, group: TaskGroup, camera: SimulatedCamera) -> Result<Table, DeployError> {
        let inside = camera.ideal().intrinsics;
        let half = inside.width as f64 / 2.0;
        let seen = Camera {
            half_extent: half * self.policy.height / inside.focal[0],
            ..self.policy.with_size(inside.width)
        };
        let scene = Arc::new(Scene::new(group, self.embodiment, seen)?);
        let arm = SimulatedArm::new(Arc::clone(&scene), self.settings.command_latency)?;
        let clock = Rc::clone(&self.clock);
        let time: Box<dyn Fn() -> Duration> = Box::new(move || clock.get());
        let pixels = vec![0; inside.width * inside.width * RGB];
        Ok(Table {
            group,
            robot: Watchdog::new(arm, time),
            renderer: SceneRenderer::with_arm(Arc::clone(&scene))?,
            ghost: TableTop::new(scene, Control::default())?,
            past: VecDeque::new(),
            ideal: [pixels.clone(), pixels],
            camera,
        })
    }

    fn set(&mut self, trial: &Trial) -> Result<SetUp, DeployError> {
        let camera = self.camera(trial)?;
        let group = trial.variant.group;
        let kept = self.table.take().filter(|table| table.group == group);
        let mut table = match kept {
            Some(table) => Table { camera, ..table },
            None => self.compile(group, camera)?,
        };
        let mut rng = ChaCha8Rng::seed_from_u64(trial.seed);
        rng.set_stream(trial.number as u64);
        let placement = table.ghost.scene().place(&mut rng);
        let element = trial.variant.element;
        table.robot.robot_mut().start(element, placement)?;
        table.ghost.reset_to(element, placement)?;
        table.past.clear();
        let parked = parked(&self.arm);
        let background = table.parked_picture(&self.arm, &parked, self.clock.get())?;
        table.remember(self.clock.get());
        let goal = table.ghost.observable_goal();
        self.table = Some(table);
        self.verdict = Verdict::default();
        Ok(SetUp { background, parked, goal })
    }

    /// Lets a control step pass.
    fn advance(&mut self) -> Result<(), DeployError> {
        let now = self.clock.get() + STEP;
        let table = self.table()?;
        let outcome = table.robot.robot_mut().advance()?;
        table.remember(now);
        self.clock.set(now);
        let verdict = &mut self.verdict;
        verdict.success |= outcome.success;
        verdict.success_at_end = outcome.success;
        self.table()?.robot.check()?;
        Ok(())
    }
}

impl Table {
    /// Keeps the present.
    fn remember(&mut self, now: Duration) {
        let state = self.robot.robot().table().simulation().save();
        self.past.push_back((now, state));
        if self.past.len() > KEPT {
            self.past.pop_front();
        }
    }

    /// Draws what an ideal camera saw at a time, or at the first moment that is known.
    fn draw(&mut self, time: Duration, which: usize) -> Result<(), EnvError> {
        let after = self.past.partition_point(|(then, _)| *then <= time);
        let found = self.past.get(after.saturating_sub(1));
        let (_, state) = found.ok_or(EnvError::NotReset)?;
        let simulation = self.ghost.simulation_mut();
        simulation.restore(state)?;
        simulation.forward_kinematics()?;
        self.renderer.render(&mut self.ghost, &mut self.ideal[which])
    }

    /// The camera's picture of the table with the arm parked.
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

    /// The camera's picture of the ideal ones.
    fn shoot(&mut self, instants: usize, now: Duration) -> Result<Vec<u8>, DeployError> {
        let Intrinsics { width, height, .. } = self.camera.calibration().intrinsics;
        let mut rgb = vec![0; width * height * RGB];
        let ideal = self.ideal.each_ref().map(|picture| &picture[..]);
        self.camera.shoot(&ideal[..instants], now.as_secs_f64(), &mut rgb)?;
        Ok(rgb)
    }

    /// The camera's newest picture, and the middle of the time in which it collected light.
    fn picture(&mut self, now: Duration) -> Result<(Vec<u8>, Duration), DeployError> {
        let imperfections = *self.camera.imperfections();
        let of = Duration::from_secs_f64;
        let end = now.saturating_sub(of(imperfections.latency));
        let begin = end.saturating_sub(of(imperfections.exposure_time));
        self.draw(end, 0)?;
        let instants = match begin < end {
            true => {
                self.draw(begin, 1)?;
                2
            }
            false => 1,
        };
        Ok((self.shoot(instants, now)?, begin + (end - begin) / 2))
    }
}

/// The random stream of a trial's camera: each trial of each variant has its own.
fn camera_stream(trial: &Trial) -> u64 {
    let variant = trial.variant.to_string();
    // FNV-1a (Fowler, Noll and Vo), which depends on no version of a library
    let name = variant.bytes().fold(0xcbf2_9ce4_8422_2325, |hash: u64, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    CAMERAS | name.wrapping_add(trial.number as u64)
}

/// The arm with its ball, made once.
fn carrying_ball() -> Result<&'static Arm, DeployError> {
    static ARM: OnceLock<Arm> = OnceLock::new();
    if let Some(arm) = ARM.get() {
        return Ok(arm);
    }
    let bare = KinovaGen3.arm()?;
    let settings = bare.settings();
    let working = bare.chain().tip(&settings.ready).rotation;
    let DVec3 { x, y, z } = working.conjugate() * BALL;
    let ball = Addition {
        link: settings.hand.clone(),
        mjcf: format!(
            r#"<geom name="ball" type="sphere" size="0.02" pos="{x} {y} {z}" mass="0" rgba="1 0 1 1"/>"#
        ),
    };
    let arm = Arm::new(ArmSettings {
        name: "kinova_gen3_with_ball".to_owned(),
        additions: vec![ball],
        ..settings.clone()
    })?;
    Ok(ARM.get_or_init(|| arm))
}

/// Ready for work, but turned away from the table.
fn parked(arm: &Arm) -> RobotState {
    let mut joints = arm.settings().ready.clone();
    if let Some(pan) = joints.first_mut() {
        *pan += std::f64::consts::PI;
    }
    RobotState { tip: arm.chain().tip(&joints), joints, closing: 0.0 }
}

impl Robot for SimulatedRig {
    fn state(&mut self) -> Result<RobotState, ControlError> {
        self.table()?.robot.state()
    }

    fn command(&mut self, command: &Command) -> Result<(), ControlError> {
        self.table()?.robot.command(command)
    }

    fn stop(&mut self) -> Result<(), ControlError> {
        match &mut self.table {
            Some(table) => table.robot.stop(),
            // nothing that could move is there
            None => Ok(()),
        }
    }
}

impl Rig for SimulatedRig {
    fn set_up(&mut self, trial: &Trial) -> Result<SetUp, BoxError> {
        Ok(self.set(trial)?)
    }

    /// Each trial is misjudged in its own way; before the first, the camera is where it is.
    fn calibration(&self) -> Calibration {
        let table = self.table.as_ref();
        table.map_or_else(|| self.truth(), |table| *table.camera.calibration())
    }

    /// The true camera: no trial misjudges it.
    fn standing_calibration(&self) -> Calibration {
        self.truth()
    }

    fn now(&self) -> Duration {
        self.clock.get()
    }

    fn wait(&mut self, time: Duration) -> Result<(), BoxError> {
        let steps = time.as_secs_f64() / STEP.as_secs_f64();
        for _ in 0..steps.round() as usize {
            self.advance()?;
        }
        Ok(())
    }

    fn picture(&mut self, rgb: &mut [u8]) -> Result<Duration, BoxError> {
        let now = self.clock.get();
        let (picture, taken) = self.table()?.picture(now)?;
        rgb.copy_from_slice(&picture);
        Ok(taken)
    }

    fn verdict(&mut self) -> Result<Verdict, BoxError> {
        Ok(std::mem::take(&mut self.verdict))
    }
}
