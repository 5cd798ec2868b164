//! A trial as an environment of one: what a policy sees of it, and how it acts.

use std::time::Instant;

use envs::carriers::Arm;
use envs::{ACTION_DIM, Control, RGB};
use glam::DVec3;
use rl::{BoxError, EnvSpec, Observations, Outcome, Transition, VectorEnv};

use crate::DeployError;
use experiments::scale;

use super::pilot::Pilot;
use super::rig::Rig;
use super::sight::Sight;
use super::stages::{Stage, Stages};
use super::strip::Strip;

/// The first picture of a trial, for a learner to recognise the group in. No robot moves.
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

/// A trial that a policy acts in.
pub(super) struct TrialEnv<'a> {
    pub rig: &'a mut dyn Rig,
    pub arm: &'a Arm,
    pub sight: Sight,
    pub pilot: Pilot,
    pub spec: EnvSpec,
    pub control: Control,
    /// Where the hand shall go, where that is told.
    pub goal: DVec3,
    /// The trial's first picture `[size, size, 3]`; empty before it.
    pub first: Vec<u8>,
    /// What the policy is told at the start.
    pub start: Observations,
    /// What the policy decided.
    pub actions: Vec<[f32; ACTION_DIM]>,
    /// How long everything took.
    pub stages: Stages,
    /// When the policy was told what it sees.
    pub told: Option<Instant>,
    pub strip: Option<&'a mut Strip>,
}

impl TrialEnv<'_> {
    /// Looks for the first time, while the robot rests.
    pub fn begin(&mut self) -> Result<(), DeployError> {
        let mut start = Observations::new(&self.spec);
        self.observe(&mut start)?;
        self.start = start;
        Ok(())
    }

    /// What the policy is told now.
    fn observe(&mut self, out: &mut Observations) -> Result<(), DeployError> {
        let mut picture = vec![0; self.spec.image[0] * self.spec.image[1] * RGB];
        let started = Instant::now();
        self.sight.shoot(self.rig)?;
        self.stages.note(Stage::Picture, started.elapsed());
        let started = Instant::now();
        self.sight.paint(self.arm, &mut picture)?;
        self.stages.note(Stage::InPainting, started.elapsed());
        if let Some(strip) = &mut self.strip {
            let perception = self.sight.perception();
            strip.add(self.sight.picture(), perception, &picture);
        }
        if self.first.is_empty() {
            self.first.clone_from(&picture);
        }
        self.sight.compose(&picture, &self.first, &mut out.images);
        let (hand, goal) = (self.sight.state().tip.position, self.goal);
        let aperture = self.arm.aperture(self.sight.state());
        let numbers = [hand.x, hand.y, hand.z, aperture, goal.x, goal.y, goal.z];
        out.vectors.copy_from_slice(&numbers.map(|number| number as f32));
        scale(&mut out.vectors);
        Ok(())
    }

    fn act(&mut self, action: &[f32], out: &mut Transition) -> Result<(), DeployError> {
        if let Some(told) = self.told {
            self.stages.note(Stage::Policy, told.elapsed());
        }
        let action = std::array::from_fn::<_, ACTION_DIM, _>(|i| action[i]);
        self.actions.push(action);
        self.pilot.decide(self.rig, &mut self.sight, action)?;
        self.stages.note(Stage::Commands, self.pilot.spent());
        let verdict = self.rig.verdict();
        let verdict = verdict.map_err(|source| DeployError::Rig { source })?;
        self.observe(&mut out.observations)?;
        out.final_observations.clone_from(&out.observations);
        // nobody pays a robot
        out.rewards.fill(0.0);
        out.success.fill(verdict.success || verdict.success_at_end);
        out.success_at_end.fill(verdict.success_at_end);
        out.outcomes.fill(match self.actions.len() < self.control.decisions() {
            true => Outcome::Running,
            false => Outcome::Truncated,
        });
        self.told = Some(Instant::now());
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

    /// The trial stands where it stands: the robot rests at its start.
    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxError> {
        out.clone_from(&self.start);
        self.told = Some(Instant::now());
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxError> {
        Ok(self.act(actions, out)?)
    }
}
