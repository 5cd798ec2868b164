//! Trial on a rig as a vectorised environment of size 1, for the choice of a policy and its
//! actions.

use std::time::Instant;

use envs::embodiments::Arm;
use envs::{ACTION_DIM, ControlSettings, RGB_CHANNELS};
use glam::DVec3;
use rl::{BoxedEnvError, EnvSpec, Observations, StepOutcome, Transition, VectorEnv};

use crate::DeployError;
use experiments::scale_observation_vectors;

use super::controller::ActionController;
use super::film_strip::FilmStrip;
use super::latency::{DecisionStage, LatencyProfile};
use super::observer::RigPerception;
use super::rig::Rig;

/// Environment that shows nothing but the first picture of a trial, for the choice of a policy. The
/// robot does not move.
pub(super) struct FirstPictureEnv<'a> {
    pub spec: &'a EnvSpec,
    pub first_observation: &'a Observations,
}

impl VectorEnv for FirstPictureEnv<'_> {
    fn spec(&self) -> &EnvSpec {
        self.spec
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        out.clone_from(self.first_observation);
        Ok(())
    }

    fn step(&mut self, _: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        out.clone_from(&Transition::new(self.spec));
        out.observations.clone_from(self.first_observation);
        out.final_observations.clone_from(self.first_observation);
        out.outcomes.fill(StepOutcome::Truncated);
        Ok(())
    }
}

/// Environment, of size 1, of a trial on a rig in which a policy acts.
pub(super) struct TrialEnv<'a> {
    pub rig: &'a mut dyn Rig,
    pub arm: &'a Arm,
    pub observer: RigPerception,
    pub controller: ActionController,
    pub spec: EnvSpec,
    pub control: ControlSettings,
    /// Goal position of the hand (metres, world); zero in tasks whose policy does not observe it.
    pub goal: DVec3,
    /// First picture of the trial `[size, size, 3]`; empty before it.
    pub first_picture: Vec<u8>,
    /// Observation at the start of the trial.
    pub first_observation: Observations,
    /// Actions that the policy took so far in the trial.
    pub actions: Vec<[f32; ACTION_DIM]>,
    /// Times that each stage of a decision took.
    pub latencies: LatencyProfile,
    /// Time at which the last observation was made; `None` before the first.
    pub last_observed_at: Option<Instant>,
    pub film_strip: Option<&'a mut FilmStrip>,
}

impl TrialEnv<'_> {
    /// Makes and stores the first observation of the trial, while the robot rests at its start.
    ///
    /// # Errors
    /// Errors of the rig and the perception.
    pub fn observe_start(&mut self) -> Result<(), DeployError> {
        let mut start = Observations::new(&self.spec);
        self.observe(&mut start)?;
        self.first_observation = start;
        Ok(())
    }

    /// Writes the current observation into `out`, which holds one environment.
    fn observe(&mut self, out: &mut Observations) -> Result<(), DeployError> {
        let mut picture =
            vec![0; self.spec.image_shape[0] * self.spec.image_shape[1] * RGB_CHANNELS];
        let started = Instant::now();
        self.observer.fetch_picture(self.rig)?;
        self.latencies.record(DecisionStage::FetchPicture, started.elapsed());
        let paint_started = Instant::now();
        self.observer.write_picture_without_arm(self.arm, &mut picture)?;
        self.latencies.record(DecisionStage::InPainting, paint_started.elapsed());
        if let Some(strip) = &mut self.film_strip {
            let perception = self.observer.perception();
            strip.mark_colour = self.observer.mark_colour();
            strip.add_decision(self.observer.camera_picture(), perception, &picture);
        }
        if self.first_picture.is_empty() {
            self.first_picture.clone_from(&picture);
        }
        self.observer.compose_observation(&picture, &self.first_picture, &mut out.images);
        let (hand, goal) = (self.observer.last_arm_state().tip.position, self.goal);
        let aperture = self.arm.aperture(self.observer.last_arm_state());
        let vector =
            envs::vector_observation(hand, aperture, goal, self.controller.target_position());
        out.vectors.copy_from_slice(&vector);
        scale_observation_vectors(&mut out.vectors);
        Ok(())
    }

    fn act(&mut self, action: &[f32], out: &mut Transition) -> Result<(), DeployError> {
        if let Some(observed) = self.last_observed_at {
            self.latencies.record(DecisionStage::ChooseAction, observed.elapsed());
        }
        let action = std::array::from_fn::<_, ACTION_DIM, _>(|i| action[i]);
        self.actions.push(action);
        self.controller.execute_action(self.rig, &mut self.observer, action)?;
        self.latencies
            .record(DecisionStage::SendCommands, self.controller.last_decision_send_duration());
        let verdict = self.rig.verdict().map_err(|source| DeployError::Rig { source })?;
        self.observe(&mut out.observations)?;
        out.final_observations.clone_from(&out.observations);
        // rewards are known in simulation only
        out.rewards.fill(0.0);
        out.success.fill(verdict.success || verdict.success_at_end);
        out.success_at_end.fill(verdict.success_at_end);
        let running = self.actions.len() < self.control.decisions_per_episode();
        out.outcomes.fill(if running { StepOutcome::Running } else { StepOutcome::Truncated });
        self.last_observed_at = Some(Instant::now());
        Ok(())
    }
}

impl VectorEnv for TrialEnv<'_> {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn horizon(&self) -> Option<usize> {
        Some(self.control.decisions_per_episode())
    }

    /// Returns the first observation again. The robot still rests at its start.
    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        out.clone_from(&self.first_observation);
        self.last_observed_at = Some(Instant::now());
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        Ok(self.act(actions, out)?)
    }
}
