//! One table-top environment without pictures: reset, step and reward.

use std::sync::Arc;

use glam::{DMat3, DVec3};
use mujoco::{Data, GeomShape, State};
use rand_chacha::ChaCha8Rng;
use robots::Capsule;
use symmetry::{D2, Irrep};

use crate::actuation::ServoArmController;
use crate::control::{ControlSettings, PHYSICS_STEPS_PER_CONTROL_STEP, clip_action};
use crate::embodiment_spec::OPEN_APERTURE;
use crate::error::EnvError;
use crate::layout::{map_point, mirrors_objects, orientation_quat};
use crate::scene::{ARM_GEOM_GROUP, HandStart, Scene, SceneKey, check_placement};
use crate::task::{EpisodeStart, ExpertCommand, Placement, StepReward, TaskState, TaskVariant};

mod simulated_arm;

pub use simulated_arm::SimulatedArm;

/// Number of action components: displacement of the hand's target along x, y and z, and the
/// fingers, each in `[-1, 1]`.
pub const ACTION_DIM: usize = 4;
/// Irreps of D2 by which the action's components transform under the symmetries.
pub const ACTION_IRREPS: [Irrep; ACTION_DIM] = [Irrep::X, Irrep::Y, Irrep::Trivial, Irrep::Trivial];
/// Number of components of the vector observation: hand x, y, z (metres from the centre), aperture
/// in `[0, 1]`, goal x, y, z (metres; zero if hidden), lead x, y, z (metres). The lead is the
/// displacement from the hand to its commanded target, without which the same action in the same
/// place could have different effects.
pub const VECTOR_OBSERVATION_DIM: usize = 10;
/// Irreps of D2 by which the vector observation's components transform under the symmetries.
pub const VECTOR_OBSERVATION_IRREPS: [Irrep; VECTOR_OBSERVATION_DIM] = [
    Irrep::X,
    Irrep::Y,
    Irrep::Trivial,
    Irrep::Trivial,
    Irrep::X,
    Irrep::Y,
    Irrep::Trivial,
    Irrep::X,
    Irrep::Y,
    Irrep::Trivial,
];

/// Returns the vector observation (see [`VECTOR_OBSERVATION_DIM`]) of a hand, its aperture, the
/// goal (zeros for a hidden one) and the hand's commanded target (metres, world frame).
pub fn vector_observation(
    hand: DVec3,
    aperture: f64,
    goal: DVec3,
    target: DVec3,
) -> [f32; VECTOR_OBSERVATION_DIM] {
    let lead = target - hand;
    [hand.x, hand.y, hand.z, aperture, goal.x, goal.y, goal.z, lead.x, lead.y, lead.z]
        .map(|value| value as f32)
}

/// Number of values of [`TableTop::state_details`]: hand x, y, z, aperture, object x, y, z, its
/// second point x, y, z (see [`TaskSceneParts::tip_body`](crate::TaskSceneParts::tip_body)) and the
/// goal x, y, z (metres from the centre), then the reward terms of [`StepReward`]: approach, in
/// place and distance of the goal (metres).
pub const STATE_DETAILS_DIM: usize = 16;

/// Factor from Meta-World's rewards of control steps, in `[0, 10]`, to rewards of decisions, in
/// `[0, 1]`.
const REWARD_SCALE: f64 = 0.1;

/// Number of control steps in which a hand follows an expert's command. In a shorter decision the
/// expert covers a share of the way: the hand's target would run ahead of the hand and swing.
const FOLLOWED: f64 = 10.0;

/// Outcome of one decision: reward, success and truncation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepResult {
    /// Reward of the decision, in `[0, 1]`: a tenth of Meta-World's reward, averaged over the
    /// control steps.
    pub reward: f64,
    /// `true` if the success condition held at any control step of the decision.
    pub success: bool,
    /// `true` if the success condition holds after the decision's last control step.
    pub success_at_end: bool,
    /// `true` if the episode has reached its time limit.
    pub truncated: bool,
}

#[derive(Clone, Debug, PartialEq)]
struct Episode {
    /// `true` if there was any contact at the end of a control step.
    touched: bool,
    element: D2,
    start: EpisodeStart,
    /// Position of the hand's target (metres, world frame).
    target: DVec3,
    /// Controller of an arm with servos; `None` if a weld moves the hand.
    controller: Option<ServoArmController>,
    decisions: usize,
    /// Finger action of the last control step, in `[-1, 1]`; 0 before the first.
    finger: f64,
}

/// Everything that determines the future of a [`TableTop`]: the simulation with its solver's warm
/// start, the arm's controller, and the episode.
#[derive(Clone, Debug, PartialEq)]
pub struct TableTopSnapshot {
    key: SceneKey,
    simulation: State,
    episode: Episode,
}

/// Table-top environment without pictures. All lengths are in metres, in the world frame.
pub struct TableTop {
    scene: Arc<Scene>,
    control: ControlSettings,
    data: Data,
    /// Simulation of the scene's other model, once a variant has used it.
    other_data: Option<Data>,
    episode: Option<Episode>,
}

impl TableTop {
    /// Creates an environment on `scene`; call a reset before the first step.
    ///
    /// # Errors
    /// [`EnvError::InvalidSetting`] for action settings out of range.
    pub fn new(scene: Arc<Scene>, control: ControlSettings) -> Result<Self, EnvError> {
        control.check()?;
        let data = Data::new(Arc::clone(&scene.model));
        Ok(Self { scene, control, data, other_data: None, episode: None })
    }

    /// Returns the scene of the environment.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Returns the environment's action settings: displacement by a full action (metres a
    /// decision), action repeat and horizon (both in control steps of 12.5 ms).
    pub fn control_settings(&self) -> ControlSettings {
        self.control
    }

    /// Returns the MuJoCo simulation, for reading positions, contacts and its state.
    pub fn simulation(&self) -> &Data {
        &self.data
    }

    /// Returns the MuJoCo simulation, for rendering or changing it. Changes affect the rest of the
    /// episode; [`TableTop::reset`] undoes them.
    pub fn simulation_mut(&mut self) -> &mut Data {
        &mut self.data
    }

    /// Starts an episode of the variant `element`, at a placement drawn from `rng`.
    ///
    /// # Errors
    /// [`EnvError::NoSuchVariant`], or MuJoCo's error for the state.
    pub fn reset(&mut self, element: D2, rng: &mut ChaCha8Rng) -> Result<(), EnvError> {
        let placement = self.scene.sample_placement(rng);
        self.reset_to(element, placement)
    }

    /// Starts an episode of the variant `element`, with object and goal at a given placement
    /// (canonical frame, metres).
    ///
    /// # Errors
    /// [`EnvError::NoSuchVariant`] or [`EnvError::NonFinitePlacement`], and nothing has changed; or
    /// MuJoCo's error for the state, and no episode is running.
    pub fn reset_to(&mut self, element: D2, placement: Placement) -> Result<(), EnvError> {
        let scene = Arc::clone(&self.scene);
        scene.layout.check_variant(element)?;
        check_placement(&placement)?;
        // ended first, so that a failure below leaves no episode on a half-set state
        self.end_episode();
        self.choose_model(element);
        let HandStart { state, controller } = scene.start(element);
        self.data.restore_state(state)?;
        self.put_objects(element, &placement)?;
        self.data.forward_kinematics()?;
        let start = EpisodeStart {
            placement,
            hand_target: scene.hand_target_start,
            task_state: self.measure(element, &placement),
        };
        self.episode = Some(Episode {
            element,
            start,
            target: map_point(element, scene.hand_target_start),
            controller: controller.clone(),
            decisions: 0,
            finger: 0.0,
            touched: false,
        });
        Ok(())
    }

    /// Exchanges the simulations if `element` mirrors the objects and the present one does not, or
    /// the other way round.
    fn choose_model(&mut self, element: D2) {
        let Some(mirrored) = &self.scene.mirrored_model else { return };
        let mirrors = mirrors_objects(element);
        if mirrors == Arc::ptr_eq(self.data.model(), mirrored) {
            return;
        }
        let model = if mirrors { mirrored } else { &self.scene.model };
        let kept = self.other_data.take();
        let chosen = kept.unwrap_or_else(|| Data::new(Arc::clone(model)));
        self.other_data = Some(std::mem::replace(&mut self.data, chosen));
    }

    /// Moves object and goal to `placement`, and the task's joints to their start positions.
    fn put_objects(&mut self, element: D2, placement: &Placement) -> Result<(), EnvError> {
        let scene = &self.scene;
        for (body, position) in [(scene.object, placement.object), (scene.goal, placement.goal)] {
            if let Some(body) = body {
                let position = map_point(element, position).to_array();
                self.data.set_mocap_position(body, position)?;
                self.data.set_mocap_orientation(body, orientation_quat(element))?;
            }
        }
        for &(address, position) in &scene.start_joints {
            self.data.qpos_mut()[address] = position;
        }
        if let Some(joint) = scene.loose_joint {
            let position = map_point(element, placement.object).to_array();
            let pose = &mut self.data.qpos_mut()[joint.qpos..][..7];
            pose[..3].copy_from_slice(&position);
            pose[3..].copy_from_slice(&orientation_quat(element));
            // in the start state the object may still be settling
            self.data.qvel_mut()[joint.qvel..][..6].fill(0.0);
        }
        if let Some(address) = scene.decoy_qpos_address {
            let position = map_point(element, placement.object).to_array();
            // the first three coordinates of a free joint are its position
            self.data.qpos_mut()[address..address + 3].copy_from_slice(&position);
        }
        Ok(())
    }

    /// Returns a snapshot of the running episode.
    ///
    /// # Errors
    /// [`EnvError::NotReset`].
    pub fn save(&self) -> Result<TableTopSnapshot, EnvError> {
        Ok(TableTopSnapshot {
            key: self.key(),
            simulation: self.data.save_state(),
            episode: self.episode.clone().ok_or(EnvError::NotReset)?,
        })
    }

    /// Restores the episode of a snapshot, which then continues bit for bit as the saved one does.
    ///
    /// # Errors
    /// [`EnvError::SceneMismatch`] for a snapshot of another scene, task or control, and nothing
    /// has changed; or MuJoCo's error for the state, and no episode is running.
    pub fn restore(&mut self, snapshot: &TableTopSnapshot) -> Result<(), EnvError> {
        let key = self.key();
        if snapshot.key != key {
            return Err(EnvError::SceneMismatch {
                got: snapshot.key.describe(&key),
                expected: key.describe(&key),
            });
        }
        self.end_episode();
        self.choose_model(snapshot.episode.element);
        self.data.restore_state(&snapshot.simulation)?;
        self.data.forward_kinematics()?;
        self.episode = Some(snapshot.episode.clone());
        Ok(())
    }

    fn key(&self) -> SceneKey {
        self.scene.key(self.control)
    }

    /// Holds `action` for one decision, simulates it, and returns reward and success. Components
    /// are clipped to `[-1, 1]`.
    ///
    /// # Errors
    /// [`EnvError::NonFiniteAction`], and nothing has moved; [`EnvError::NotReset`] before a reset
    /// and after the end of an episode; [`EnvError::Simulation`] if the simulation diverges, which
    /// ends the episode.
    pub fn step(&mut self, action: &[f32; ACTION_DIM]) -> Result<StepResult, EnvError> {
        let [x, y, z, finger] = clip_action(action)?;
        let decisions = self.control.decisions_per_episode();
        // taken out, so that a failed simulation leaves no episode to continue
        let running = self.episode.take_if(|episode| episode.decisions < decisions);
        let mut episode = running.ok_or(EnvError::NotReset)?;
        let repeat = self.control.action_repeat as f64;
        // spread evenly over the control steps, so that `displacement` is the length per decision
        let move_by = DVec3::new(x, y, z) * self.control.displacement / repeat;
        let mut step = StepResult::default();
        for _ in 0..self.control.action_repeat {
            let now = self.control_step(&mut episode, move_by, finger)?;
            step.reward += now.reward * REWARD_SCALE / repeat;
            step.success |= now.success;
            step.success_at_end = now.success;
        }
        episode.decisions += 1;
        step.truncated = episode.decisions == decisions;
        self.episode = Some(episode);
        Ok(step)
    }

    /// Moves the hand's target by `move_by` (metres) and simulates one control step of 12.5 ms.
    fn control_step(
        &mut self,
        episode: &mut Episode,
        move_by: DVec3,
        finger: f64,
    ) -> Result<StepReward, EnvError> {
        let [low, high] = self.scene.target_bounds;
        episode.target = (episode.target + move_by).clamp(low, high);
        if let Some(controller) = &episode.controller {
            episode.target = controller.within_lead(episode.target, self.hand_position());
        }
        let target = episode.target;
        self.data.set_mocap_position(self.scene.hand_target, target.to_array())?;
        match &mut episode.controller {
            None => self.data.set_all_ctrl(&[finger, -finger])?,
            Some(controller) => controller.advance(&mut self.data, target, finger)?,
        }
        self.pass(episode, finger)
    }

    /// Simulates one control step of 12.5 ms with the controls as they are, and returns its reward.
    fn pass(&mut self, episode: &mut Episode, finger: f64) -> Result<StepReward, EnvError> {
        self.data.step(PHYSICS_STEPS_PER_CONTROL_STEP)?;
        episode.finger = finger;
        episode.touched |= self.data.contacts().next().is_some();
        // `step` leaves positions one physics step behind; kinematics alone do not alter the state
        self.data.forward_kinematics()?;
        let now = self.measure(episode.element, &episode.start.placement);
        Ok(self.scene.group.identity_task().reward(&episode.start, &now, finger))
    }

    /// Returns the variant of the last episode, running or finished; `None` before the first reset
    /// and after a failure.
    pub fn variant(&self) -> Option<TaskVariant> {
        let group = self.scene.group;
        let element = self.episode.as_ref()?.element;
        Some(TaskVariant { group, element })
    }

    /// Returns `true` if there was any contact at the end of a control step of the running episode.
    pub(crate) fn had_contact(&self) -> bool {
        self.episode.as_ref().is_some_and(|episode| episode.touched)
    }

    /// Ends the environment's running episode, if any.
    pub(crate) fn end_episode(&mut self) {
        self.episode = None;
    }

    /// Returns the position of the hand body (metres, world frame).
    pub fn hand_position(&self) -> DVec3 {
        DVec3::from_array(self.data.body_position(self.scene.hand))
    }

    /// Returns the capsules that enclose the arm (metres, world frame); none for a hand that a weld
    /// moves.
    ///
    /// # Errors
    /// [`EnvError::NotReset`].
    pub(crate) fn arm_capsules(&self) -> Result<Vec<Capsule>, EnvError> {
        let episode = self.episode.as_ref().ok_or(EnvError::NotReset)?;
        let controller = episode.controller.as_ref();
        Ok(controller.map_or_else(Vec::new, |of| of.capsules(&self.data)))
    }

    /// Returns the goal's position in the last episode (metres, world frame); `None` for tasks with
    /// a hidden goal, before the first reset and after a failure.
    pub fn observable_goal(&self) -> Option<DVec3> {
        let episode = self.episode.as_ref()?;
        let goal = map_point(episode.element, episode.start.placement.goal);
        self.scene.goal_observable.then_some(goal)
    }

    /// Returns the vector observation of the present state, see [`VECTOR_OBSERVATION_DIM`].
    ///
    /// # Errors
    /// [`EnvError::NotReset`].
    pub fn observe(&self) -> Result<[f32; VECTOR_OBSERVATION_DIM], EnvError> {
        let episode = self.episode.as_ref().ok_or(EnvError::NotReset)?;
        let goal = self.observable_goal().unwrap_or(DVec3::ZERO);
        Ok(vector_observation(self.hand_position(), self.aperture(), goal, episode.target))
    }

    /// Returns the positions of the present state and its reward terms for the finger action of the
    /// last control step (0 before the first), as listed at [`STATE_DETAILS_DIM`]; nothing moves.
    ///
    /// # Errors
    /// [`EnvError::NotReset`].
    pub fn state_details(&self) -> Result<[f32; STATE_DETAILS_DIM], EnvError> {
        let episode = self.episode.as_ref().ok_or(EnvError::NotReset)?;
        let (now, placement) = (self.task_state()?, episode.start.placement);
        let terms = self.reward(episode.finger)?;
        let [x, y, z, aperture, ..] = self.observe()?;
        let mut details = [0.0; STATE_DETAILS_DIM];
        details[..4].copy_from_slice(&[x, y, z, aperture]);
        let points = [now.object, now.tip, placement.goal];
        for (out, point) in details[4..13].chunks_exact_mut(3).zip(points) {
            let [px, py, pz] = map_point(episode.element, point).to_array();
            out.copy_from_slice(&[px as f32, py as f32, pz as f32]);
        }
        let terms = [terms.approach_reward, terms.in_place_reward, terms.goal_distance];
        details[13..].copy_from_slice(&terms.map(|term| term as f32));
        Ok(details)
    }

    /// Returns the scripted expert's action for the present state (world frame).
    ///
    /// # Errors
    /// [`EnvError::NotReset`], [`EnvError::NonFiniteCommand`].
    pub fn expert_action(&self) -> Result<[f32; ACTION_DIM], EnvError> {
        let episode = self.episode.as_ref().ok_or(EnvError::NotReset)?;
        let ExpertCommand { hand, finger } = self.expert_command()?;
        if !(hand.is_finite() && finger.is_finite()) {
            let group = self.scene.group;
            return Err(EnvError::NonFiniteCommand { group, hand, finger });
        }
        // experts command in the canonical frame, and actions are in the world's
        let here = map_point(episode.element, self.hand_position());
        let share = (self.control.action_repeat as f64 / FOLLOWED).min(1.0);
        let wanted = map_point(episode.element, hand - here) / self.control.displacement * share;
        // each axis alone, as a policy's actions are clipped
        let bounded = wanted.clamp(DVec3::NEG_ONE, DVec3::ONE);
        Ok([bounded.x as f32, bounded.y as f32, bounded.z as f32, finger as f32])
    }

    /// Returns the scripted expert's command for the present state.
    pub(crate) fn expert_command(&self) -> Result<ExpertCommand, EnvError> {
        let episode = self.episode.as_ref().ok_or(EnvError::NotReset)?;
        let task = self.scene.group.identity_task();
        Ok(task.expert(&episode.start.placement, &self.task_state()?))
    }

    /// Returns the reward of the present state for the finger action `finger`; nothing moves.
    pub(crate) fn reward(&self, finger: f64) -> Result<StepReward, EnvError> {
        let episode = self.episode.as_ref().ok_or(EnvError::NotReset)?;
        let now = self.task_state()?;
        Ok(self.scene.group.identity_task().reward(&episode.start, &now, finger))
    }

    /// Returns the present state of the task, on which the reward depends (canonical frame).
    ///
    /// # Errors
    /// [`EnvError::NotReset`].
    pub fn task_state(&self) -> Result<TaskState, EnvError> {
        let episode = self.episode.as_ref().ok_or(EnvError::NotReset)?;
        Ok(self.measure(episode.element, &episode.start.placement))
    }

    fn aperture(&self) -> f64 {
        let [right, left] =
            self.scene.claw_bodies.map(|body| DVec3::from_array(self.data.body_position(body)));
        (right.distance(left) / OPEN_APERTURE).clamp(0.0, 1.0)
    }

    fn measure(&self, element: D2, placement: &Placement) -> TaskState {
        let [right, left] =
            self.scene.tip_sites.map(|site| DVec3::from_array(self.data.site_position(site)));
        let at = |body| map_point(element, DVec3::from_array(self.data.body_position(body)));
        let object = self.scene.object_body.map_or(placement.object, at) + self.scene.object_offset;
        let [low, high] = self.scene.pad_bodies.map(|body| at(body).y);
        TaskState {
            hand: map_point(element, self.hand_position()),
            tcp: map_point(element, (right + left) / 2.0),
            aperture: self.aperture(),
            object,
            tip: self.scene.tip_body.map_or(object, at),
            // a flip exchanges the sides
            pads: if element.flips_y() { [high, low] } else { [low, high] },
        }
    }
}

/// Geom groups that pictures show: tables and objects, and the arm. Collision shapes and marks are
/// in other groups.
const SHOWN: std::ops::RangeInclusive<usize> = 0..=ARM_GEOM_GROUP;

/// Geom of a scene that a camera may see: shape, pose and colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisibleGeom<'a> {
    /// Unique name in the scene; `None` only for geoms of foreign scenes.
    pub name: Option<&'a str>,
    /// Shape of the geom in its own frame (metres).
    pub shape: GeomShape,
    /// Position of the geom's centre (metres, world frame).
    pub position: DVec3,
    /// Axes x, y and z of the geom in the world frame, as columns.
    pub axes: DMat3,
    /// Colour of the geom: red, green, blue and opacity, each in `[0, 1]`.
    pub rgba: [f32; 4],
    /// `true` for geoms of the arm and the gripper.
    pub is_arm: bool,
}

impl TableTop {
    /// Returns every sphere, capsule, cylinder and box that a camera may see, the arm's included,
    /// in the scene's order.
    pub fn visible_geoms(&self) -> impl Iterator<Item = VisibleGeom<'_>> {
        let (data, model) = (&self.data, self.data.model());
        model.geoms().filter_map(move |geom| {
            let group = model.geom_group(geom);
            SHOWN.contains(&group).then_some(())?;
            Some(VisibleGeom {
                name: model.name_of(geom),
                shape: model.geom_shape(geom)?,
                position: DVec3::from_array(data.geom_position(geom)),
                axes: DMat3::from_cols_array_2d(&data.geom_axes(geom)),
                rgba: model.geom_rgba(geom),
                is_arm: group == ARM_GEOM_GROUP,
            })
        })
    }
}
