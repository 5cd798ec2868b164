//! Learnt policies on a rig.

use std::sync::Arc;
use std::time::Instant;

use envs::carriers::Arm;
use envs::{
    ACTION_DIM, Camera, Control, Layout, RGB, Scene, SceneRenderer, TableTop, TaskGroup,
    VecEnvSettings,
};
use glam::DVec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{EnvSpec, Observations};
use robots::RobotState;
use symmetry::D2;

use crate::DeployError;
use experiments::{Experiment, RunError, RunFolder, Stream};
use learner::{Labels, Learner, LearnerSettings, Recognised};

use super::dry_run::{DryRun, Rehearsal};
use super::pilot::Pilot;
use super::plausibility;
use super::rig::{Rig, SetUp, Trial, then_stop};
use super::settings::SightSettings;
use super::sight::Sight;
use super::stages::{Stage, Stages};
use super::strip::Strip;
use super::table::TrialScore;
use super::trial::{FirstPicture, TrialEnv};

/// Policies of a run, and what they know of pictures.
pub struct Deployment {
    learner: Box<dyn Learner>,
    spec: EnvSpec,
    control: Control,
    camera: Camera,
    /// The empty table `[drawn_size, drawn_size, 3]` as the policies know it.
    table: Vec<u8>,
    sight: SightSettings,
}

impl Deployment {
    /// The policies of the newest intact checkpoint in `folder`.
    ///
    /// # Errors
    /// As [`RunFolder::experiment`] and [`RunFolder::load_learner`], and what the scene says of the
    /// empty table; [`RunError::Setting`] for policies that have learnt in another layout, with
    /// decisions that twists cannot follow, or with a context, which reads rewards.
    pub fn load(folder: &RunFolder, sight: SightSettings) -> Result<Self, DeployError> {
        let Experiment { learner, mut envs, .. } = folder.experiment()?;
        check(&learner, &envs)?;
        envs.num_envs = 1;
        let spec = Stream::spec_of(&envs);
        let drawn = envs.camera.with_size(envs.camera.drawn_size());
        let mut table = vec![0; drawn.size * drawn.size * RGB];
        let empty = TaskGroup::GOAL_REACH;
        let scene = Arc::new(Scene::new(empty, envs.embodiment, drawn)?);
        let mut top = TableTop::new(Arc::clone(&scene), envs.control)?;
        top.reset(D2::Identity, &mut ChaCha8Rng::seed_from_u64(0))?;
        SceneRenderer::of_table(scene)?.render(&mut top, &mut table)?;
        Ok(Self {
            learner: folder.load_learner(&learner, &spec, &Labels::default())?,
            spec,
            control: envs.control,
            camera: envs.camera,
            table,
            sight,
        })
    }

    /// The camera that the policies have learnt with.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Sets the table for a trial, lets the learner choose a policy by the first picture, and lets
    /// it act. `arm` is what is known of the rig's robot. The robot is told to stop at the end, and
    /// before an error is returned, but for one of the calibration, before which it is told nothing.
    ///
    /// # Errors
    /// [`DeployError::OtherCamera`] for a calibration that is not of the rig's camera;
    /// [`DeployError::Rig`], [`DeployError::Robot`], [`DeployError::StalePicture`],
    /// [`DeployError::PictureOfTheFuture`], directly or as the cause of [`RunError::Rl`]; what
    /// perception or the learner says.
    pub fn trial(
        &mut self,
        rig: &mut dyn Rig,
        arm: &Arm,
        trial: &Trial,
        strip: Option<&mut Strip>,
    ) -> Result<TrialScore, DeployError> {
        Ok(self.run(rig, arm, trial, strip)?.score)
    }

    /// Does all that a trial does, but tells the robot nothing: it stands where it stands, on a
    /// table that is as it is, and the rig is not told to set it up.
    ///
    /// # Errors
    /// As [`Deployment::trial`].
    pub fn rehearse(
        &mut self,
        rig: &mut dyn Rig,
        arm: &Arm,
        trial: &Trial,
    ) -> Result<Rehearsal, DeployError> {
        let mut dry = DryRun::new(rig, arm)?;
        let played = self.run(&mut dry, arm, trial, None)?;
        Ok(Rehearsal {
            policy: played.score.policy,
            fits: played.score.fits,
            actions: played.actions,
            stages: played.stages,
            withheld: dry.into_withheld(),
        })
    }

    fn run(
        &mut self,
        rig: &mut dyn Rig,
        arm: &Arm,
        trial: &Trial,
        strip: Option<&mut Strip>,
    ) -> Result<Played, DeployError> {
        self.check_calibration(rig)?;
        let env = self.env(&mut *rig, arm, trial, strip);
        let played = env.and_then(|mut env| {
            let score = self.play(&mut env, trial)?;
            Ok(Played { score, actions: env.actions, stages: env.stages })
        });
        then_stop(rig, played)
    }

    /// Refuses a calibration from a file that cannot be of the rig's camera, before the arm moves.
    /// The rig's standing estimate is the same in every trial, and so is the answer.
    ///
    /// # Errors
    /// [`DeployError::OtherCamera`].
    pub(super) fn check_calibration(&self, rig: &dyn Rig) -> Result<(), DeployError> {
        let file = self.sight.calibration;
        file.map_or(Ok(()), |file| plausibility::check(&file, &rig.standing_calibration()))
    }

    /// What a policy sees of a table that was set as `set_up` says, from `start` on.
    pub(super) fn sight(
        &self,
        rig: &dyn Rig,
        arm: &Arm,
        set_up: &SetUp,
        start: RobotState,
    ) -> Result<Sight, DeployError> {
        let calibration = self.sight.calibration;
        let calibration = calibration.unwrap_or_else(|| rig.calibration());
        let known = (&self.camera, &self.table[..]);
        Sight::new(&self.sight, arm, calibration, known, set_up, (rig.now(), start))
    }

    /// The table of a trial once it is set, as an environment.
    fn env<'a>(
        &self,
        rig: &'a mut dyn Rig,
        arm: &'a Arm,
        trial: &Trial,
        strip: Option<&'a mut Strip>,
    ) -> Result<TrialEnv<'a>, DeployError> {
        let set_up = rig.set_up(trial);
        let set_up = set_up.map_err(|source| DeployError::Rig { source })?;
        let start = rig.state()?;
        let pilot = Pilot::new(arm, &self.control, &start);
        let sight = self.sight(rig, arm, &set_up, start)?;
        Ok(TrialEnv {
            pilot,
            rig,
            arm,
            sight,
            spec: self.spec.clone(),
            control: self.control,
            goal: set_up.goal.unwrap_or(DVec3::ZERO),
            first: Vec::new(),
            start: Observations::new(&self.spec),
            actions: Vec::new(),
            stages: Stages::default(),
            told: None,
            strip,
        })
    }

    /// Lets the learner choose a policy, and lets that act.
    fn play(&mut self, env: &mut TrialEnv, trial: &Trial) -> Result<TrialScore, DeployError> {
        env.begin()?;
        let mut rng = ChaCha8Rng::seed_from_u64(trial.seed);
        let mut look = FirstPicture { spec: &self.spec, first: &env.start };
        let started = Instant::now();
        let Recognised { policy, fits } = self.learner.recognise(&mut look, Some(1), &mut rng)?;
        env.stages.note(Stage::Recognition, started.elapsed());
        let stats = self.learner.perform(policy, env, 1)?.stats;
        Ok(TrialScore {
            group: trial.variant.group,
            element: trial.variant.element,
            number: trial.number,
            policy,
            fits,
            success: stats.success_rate() == Some(1.0),
            success_at_end: stats.success_at_end_rate() == Some(1.0),
            refused: env.pilot.refused(),
        })
    }
}

/// What came of a trial, and how.
struct Played {
    score: TrialScore,
    actions: Vec<[f32; ACTION_DIM]>,
    stages: Stages,
}

/// Refuses policies that would act otherwise than they have learnt to.
pub(super) fn check(learner: &LearnerSettings, envs: &VecEnvSettings) -> Result<(), DeployError> {
    let refuse =
        |name, value: String, expected| Err(RunError::Setting { name, value, expected }.into());
    if envs.layout != Layout::Symmetric {
        return refuse("envs.layout", envs.layout.to_string(), "`symmetric`");
    }
    if !Pilot::keeps_time(&envs.control) {
        return refuse(
            "envs.control.action_repeat",
            envs.control.action_repeat.to_string(),
            "an even number: an arm takes a command every second control step",
        );
    }
    match learner {
        LearnerSettings::OffPolicy(settings) if settings.context.is_some() => refuse(
            "off_policy.context",
            "set".to_owned(),
            "none: a context reads rewards, and nobody pays a robot",
        ),
        _ => Ok(()),
    }
}
