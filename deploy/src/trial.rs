//! Trial on a rig as a vector of one environment, in which a learner chooses a policy and acts.

use std::time::Instant;

use envs::embodiments::Arm;
use envs::{ACTION_DIM, Control, RGB};
use glam::DVec3;
use rl::{BoxError, EnvSpec, Observations, Outcome, Transition, VectorEnv};

use crate::DeployError;
use experiments::scale;

use super::controller::ActionController;
use super::film_strip::FilmStrip;
use super::latency::{LatencyProfile, Stage};
use super::observer::Observer;
use super::rig::Rig;

/// Environment that shows nothing but the first picture of a trial, for the choice of a policy. The
/// robot does not move.
pub(super) struct FirstPicture<'a> {
    pub spec: &'a EnvSpec,
    pub first: &'a Observations,
}

impl VectorEnv for FirstPicture<'_> {
    fn spec(&self) -> &EnvSpec {
        self.spec
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxError> {
        out.clone_from(self.first);
        Ok(())
    }

    fn step(&mut self, _: &[f32], out: &mut Transition) -> Result<(), BoxError> {
        out.clone_from(&Transition::new(self.spec));
        out.observations.clone_from(self.first);
        out.final_observations.clone_from(self.first);
        out.outcomes.fill(Outcome::Truncated);
        Ok(())
    }
}

/// Environment of a trial in which a policy acts.
pub(super) struct TrialEnv<'a> {
    pub rig: &'a mut dyn Rig,
    pub arm: &'a Arm,
    pub observer: Observer,
    pub controller: ActionController,
    pub spec: EnvSpec,
    pub control: Control,
    /// Goal position of the hand (metres, world); zero in tasks whose policy does not observe it.
    pub goal: DVec3,
    /// First picture of the trial `[size, size, 3]`; empty before it.
    pub first: Vec<u8>,
    /// Observation at the start of the trial.
    pub start: Observations,
    /// Actions of the policy so far.
    pub actions: Vec<[f32; ACTION_DIM]>,
    /// Times that each stage of a decision took.
    pub latencies: LatencyProfile,
    /// Time of the last observation; `None` before the first.
    pub observed: Option<Instant>,
    pub strip: Option<&'a mut FilmStrip>,
}

impl TrialEnv<'_> {
    /// Makes the first observation while the robot rests.
    ///
    /// # Errors
    /// Errors of the rig and the perception.
    pub fn begin(&mut self) -> Result<(), DeployError> {
        let mut start = Observations::new(&self.spec);
        self.observe(&mut start)?;
        self.start = start;
        Ok(())
    }

    /// Writes the current observation into `out` `[1, ..]`.
    fn observe(&mut self, out: &mut Observations) -> Result<(), DeployError> {
        let mut picture = vec![0; self.spec.image[0] * self.spec.image[1] * RGB];
        let started = Instant::now();
        self.observer.shoot(self.rig)?;
        self.latencies.record(Stage::Picture, started.elapsed());
        let paint_started = Instant::now();
        self.observer.paint(self.arm, &mut picture)?;
        self.latencies.record(Stage::InPainting, paint_started.elapsed());
        if let Some(strip) = &mut self.strip {
            let perception = self.observer.perception();
            strip.add(self.observer.picture(), perception, &picture);
        }
        if self.first.is_empty() {
            self.first.clone_from(&picture);
        }
        self.observer.compose(&picture, &self.first, &mut out.images);
        let (hand, goal) = (self.observer.state().tip.position, self.goal);
        let aperture = self.arm.aperture(self.observer.state());
        // order of the vector in training
        let numbers = [hand.x, hand.y, hand.z, aperture, goal.x, goal.y, goal.z];
        out.vectors.copy_from_slice(&numbers.map(|number| number as f32));
        scale(&mut out.vectors);
        Ok(())
    }

    fn act(&mut self, action: &[f32], out: &mut Transition) -> Result<(), DeployError> {
        if let Some(observed) = self.observed {
            self.latencies.record(Stage::Policy, observed.elapsed());
        }
        let action = std::array::from_fn::<_, ACTION_DIM, _>(|i| action[i]);
        self.actions.push(action);
        self.controller.decide(self.rig, &mut self.observer, action)?;
        self.latencies.record(Stage::Commands, self.controller.spent());
        let verdict = self.rig.verdict().map_err(|source| DeployError::Rig { source })?;
        self.observe(&mut out.observations)?;
        out.final_observations.clone_from(&out.observations);
        // rewards are known in simulation only
        out.rewards.fill(0.0);
        out.success.fill(verdict.success || verdict.success_at_end);
        out.success_at_end.fill(verdict.success_at_end);
        let running = self.actions.len() < self.control.decisions();
        out.outcomes.fill(if running { Outcome::Running } else { Outcome::Truncated });
        self.observed = Some(Instant::now());
        Ok(())
    }
}

impl VectorEnv for TrialEnv<'_> {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn horizon(&self) -> Option<usize> {
        Some(self.control.decisions())
    }

    /// Returns the first observation again. The robot still rests at its start.
    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxError> {
        out.clone_from(&self.start);
        self.observed = Some(Instant::now());
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxError> {
        Ok(self.act(actions, out)?)
    }
}
