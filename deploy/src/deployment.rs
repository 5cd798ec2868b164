//! Deployment of a run's policies on a rig.

use std::sync::Arc;
use std::time::Instant;

use envs::embodiments::Arm;
use envs::{
    ACTION_DIM, Camera, ControlSettings, Layout, RGB_CHANNELS, Scene, SceneRenderer, TableTop,
    TaskGroup, VecEnvSettings,
};
use glam::DVec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{EnvSpec, Observations};
use robots::RobotState;
use symmetry::D2;

use crate::DeployError;
use experiments::{Experiment, RunError, RunFolder, SwitchableVecEnv};
use learner::{Learner, LearnerSettings, RecognisedPolicy, TaskLabel};

use super::controller::ActionController;
use super::dry_run::{DryRunReport, DryRunRig};
use super::film_strip::FilmStrip;
use super::latency::{DecisionStage, LatencyProfile};
use super::observer::RigPerception;
use super::plausibility;
use super::rig::{PreparedTrial, Rig, Trial, stop_after};
use super::settings::VisionSettings;
use super::table::TrialResult;
use super::trial::{FirstPictureEnv, TrialEnv};

/// Largest distance (mm) of the hand that a robot reports from that of the arm's model.
const MAX_MODEL_ERROR_MM: f64 = 30.0;
/// Largest angle (degrees) between the hand that a robot reports and that of the arm's model.
const MAX_MODEL_ERROR_DEG: f64 = 6.0;

/// Policies of a run, ready to act on a rig, with the camera and a picture of the empty table of
/// their training.
pub struct Deployment {
    learner: Box<dyn Learner>,
    spec: EnvSpec,
    control: ControlSettings,
    camera: Camera,
    /// Picture of the empty table `[rendered_size, rendered_size, 3]` by the camera of training.
    table: Vec<u8>,
    vision: VisionSettings,
}

impl Deployment {
    /// Loads the policies of the newest intact checkpoint in `folder`.
    ///
    /// # Errors
    /// As [`RunFolder::read_experiment`] and [`RunFolder::load_learner`], and errors of the scene;
    /// [`RunError::InvalidSetting`] for policies that were trained in another layout, with
    /// decisions that are no multiple of the arm's control period, or with a context, which needs
    /// rewards.
    pub fn load(folder: &RunFolder, vision: VisionSettings) -> Result<Self, DeployError> {
        let Experiment { learner, mut envs, .. } = folder.read_experiment()?;
        check_training_conditions(&learner, &envs)?;
        // a rig has one robot
        envs.num_envs = 1;
        let spec = SwitchableVecEnv::env_spec(&envs);
        let drawn = envs.camera.with_size(envs.camera.rendered_size());
        let mut table = vec![0; drawn.size * drawn.size * RGB_CHANNELS];
        // the group that puts nothing on the table
        let empty = TaskGroup::GOAL_REACH;
        let scene = Arc::new(Scene::new(empty, envs.embodiment, drawn)?);
        let mut top = TableTop::new(Arc::clone(&scene), envs.control)?;
        top.reset(D2::Identity, &mut ChaCha8Rng::seed_from_u64(0))?;
        SceneRenderer::without_arm(scene)?.render(&mut top, &mut table)?;
        Ok(Self {
            learner: folder.load_learner(&learner, &spec, &TaskLabel::default())?,
            spec,
            control: envs.control,
            camera: envs.camera,
            table,
            vision,
        })
    }

    /// Returns the camera that the policies were trained with.
    pub fn training_camera(&self) -> &Camera {
        &self.camera
    }

    /// Runs a trial: sets the table up, lets the learner choose a policy from the first picture,
    /// and lets the policy act. `arm` is the model of the rig's robot. The robot is stopped at the
    /// end and before any error is returned, except [`DeployError::ImplausibleCalibration`], before
    /// which it is sent nothing.
    ///
    /// # Errors
    /// [`DeployError::ImplausibleCalibration`] for a calibration that is not that of the rig's
    /// camera;
    /// [`DeployError::Rig`], [`DeployError::Robot`], [`DeployError::StalePicture`],
    /// [`DeployError::CameraClockAhead`], directly or as the cause of [`RunError::Rl`]; errors of
    /// the perception and the learner.
    pub fn run_trial(
        &mut self,
        rig: &mut dyn Rig,
        arm: &Arm,
        trial: &Trial,
        strip: Option<&mut FilmStrip>,
    ) -> Result<TrialResult, DeployError> {
        Ok(self.run(rig, arm, trial, strip)?.score)
    }

    /// Runs a trial without a set-up and without sending anything to the robot, which stays where
    /// it is.
    ///
    /// # Errors
    /// As [`Deployment::run_trial`].
    pub fn dry_run(
        &mut self,
        rig: &mut dyn Rig,
        arm: &Arm,
        trial: &Trial,
    ) -> Result<DryRunReport, DeployError> {
        let mut dry = DryRunRig::new(rig, arm)?;
        let played = self.run(&mut dry, arm, trial, None)?;
        Ok(DryRunReport {
            policy: played.score.policy,
            policy_fits: played.score.policy_fits,
            actions: played.actions,
            latencies: played.latencies,
            unsent_commands: dry.into_unsent_commands(),
        })
    }

    fn run(
        &mut self,
        rig: &mut dyn Rig,
        arm: &Arm,
        trial: &Trial,
        strip: Option<&mut FilmStrip>,
    ) -> Result<Played, DeployError> {
        // outside of `stop_after`: an error here must not send anything to the robot
        self.check_calibration(rig)?;
        let env = self.env(&mut *rig, arm, trial, strip);
        let played = env.and_then(|mut env| {
            let score = self.play(&mut env, trial)?;
            Ok(Played { score, actions: env.actions, latencies: env.latencies })
        });
        stop_after(rig, played)
    }

    /// Rejects a calibration from a file that cannot be that of the rig's camera. Does not move the
    /// arm.
    ///
    /// # Errors
    /// [`DeployError::ImplausibleCalibration`].
    pub(super) fn check_calibration(&self, rig: &dyn Rig) -> Result<(), DeployError> {
        // the estimate of a single trial would accept a file in one trial and reject it in the next
        let file = self.vision.calibration;
        file.map_or(Ok(()), |file| {
            plausibility::check_plausibility(&file, &rig.trial_independent_calibration())
        })
    }

    /// Creates the perception for a trial whose table is set up as `set_up`, with the arm in the
    /// state `start`.
    pub(super) fn observer(
        &self,
        rig: &dyn Rig,
        arm: &Arm,
        set_up: &PreparedTrial,
        start: RobotState,
    ) -> Result<RigPerception, DeployError> {
        let calibration = self.vision.calibration.unwrap_or_else(|| rig.calibration());
        let start = (rig.now(), start);
        RigPerception::new(&self.vision, arm, calibration, &self.camera, &self.table, set_up, start)
    }

    /// Sets the table up for a trial and returns the trial as an environment.
    fn env<'a>(
        &self,
        rig: &'a mut dyn Rig,
        arm: &'a Arm,
        trial: &Trial,
        strip: Option<&'a mut FilmStrip>,
    ) -> Result<TrialEnv<'a>, DeployError> {
        let set_up = rig.set_up(trial).map_err(|source| DeployError::Rig { source })?;
        check_goal(trial, set_up.goal)?;
        let start = rig.state()?;
        check_state(arm, &start)?;
        let controller = ActionController::new(arm, &self.control, &start);
        let observer = self.observer(rig, arm, &set_up, start)?;
        Ok(TrialEnv {
            controller,
            rig,
            arm,
            observer,
            spec: self.spec.clone(),
            control: self.control,
            goal: set_up.goal.unwrap_or(DVec3::ZERO),
            first_picture: Vec::new(),
            first_observation: Observations::new(&self.spec),
            actions: Vec::new(),
            latencies: LatencyProfile::default(),
            last_observed_at: None,
            film_strip: strip,
        })
    }

    /// Lets the learner choose a policy, and lets the policy act for one episode.
    fn play(&mut self, env: &mut TrialEnv, trial: &Trial) -> Result<TrialResult, DeployError> {
        env.observe_start()?;
        let mut rng = ChaCha8Rng::seed_from_u64(trial.seed);
        let mut look =
            FirstPictureEnv { spec: &self.spec, first_observation: &env.first_observation };
        let started = Instant::now();
        let RecognisedPolicy { policy, fits } =
            self.learner.recognise_policy(&mut look, Some(1), &mut rng)?;
        env.latencies.record(DecisionStage::ChoosePolicy, started.elapsed());
        let stats = self.learner.evaluate_policy(policy, env, 1)?.stats;
        Ok(TrialResult {
            group: trial.variant.group,
            element: trial.variant.element,
            trial_index: trial.index,
            policy,
            policy_fits: fits,
            success: stats.success_rate() == Some(1.0),
            success_at_end: stats.success_at_end_rate() == Some(1.0),
            refused_commands: env.controller.num_refused_commands(),
        })
    }
}

/// Rejects a missing goal, one that the policy does not observe, and one that the hand cannot be
/// sent to.
pub(super) fn check_goal(trial: &Trial, goal: Option<DVec3>) -> Result<(), DeployError> {
    let group = trial.variant.group;
    let is_observed = group.identity_task().parts().goal_observable;
    let Some(goal) = goal else {
        return if is_observed { Err(DeployError::MissingGoal { group }) } else { Ok(()) };
    };
    let [low, high] = Layout::Symmetric.hand_target_bounds();
    if !is_observed {
        return Err(DeployError::ImplausibleGoal {
            goal,
            expected: format!("none: policies of {group} do not observe one"),
        });
    }
    if goal.cmpge(low).all() && goal.cmple(high).all() {
        return Ok(());
    }
    Err(DeployError::ImplausibleGoal {
        goal,
        expected: format!("a position from {low} to {high} m"),
    })
}

/// Rejects a state of the robot whose hand is not where the arm's model has it for its joints.
fn check_state(arm: &Arm, state: &RobotState) -> Result<(), DeployError> {
    let dofs = arm.chain().joints().len();
    if state.joints.len() != dofs {
        let (got, expected) = (state.joints.len(), dofs);
        return Err(DeployError::JointCount { got, expected });
    }
    let [way, turn] = arm.chain().tip_pose(&state.joints).displacement_to(&state.tip);
    let (way_mm, turn_deg) = (1e3 * way.length(), turn.length().to_degrees());
    if way_mm <= MAX_MODEL_ERROR_MM && turn_deg <= MAX_MODEL_ERROR_DEG {
        return Ok(());
    }
    Err(DeployError::ImplausibleState { way_mm, turn_deg })
}

/// Result of a trial with its actions and times.
struct Played {
    score: TrialResult,
    actions: Vec<[f32; ACTION_DIM]>,
    latencies: LatencyProfile,
}

/// Rejects policies that would act under other conditions than those of their training.
pub(super) fn check_training_conditions(
    learner: &LearnerSettings,
    envs: &VecEnvSettings,
) -> Result<(), DeployError> {
    let refuse =
        |name, value: String, expected| Err(RunError::invalid(name, value, expected).into());
    if envs.layout != Layout::Symmetric {
        return refuse("envs.layout", envs.layout.to_string(), "`symmetric`");
    }
    if !ActionController::supports_decision_duration(&envs.control) {
        return refuse(
            "envs.control.action_repeat",
            envs.control.action_repeat.to_string(),
            "an even number: an arm takes a command every second control step",
        );
    }
    if !envs.camera.is_aligned() {
        return refuse(
            "envs.camera.misalignment",
            "set".to_owned(),
            "none: pictures of the real camera are rectified by its calibration",
        );
    }
    match learner {
        LearnerSettings::OffPolicy(settings) if settings.context.is_some() => refuse(
            "off_policy.context",
            "set".to_owned(),
            "none: a context reads rewards, which only a simulation knows",
        ),
        _ => Ok(()),
    }
}
