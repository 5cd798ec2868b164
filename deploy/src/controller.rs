//! Decisions become twists, 40 of them a second.

use std::time::{Duration, Instant};

use envs::carriers::Arm;
use envs::{ACTION_DIM, Control, Layout};
use glam::{DQuat, DVec3};
use robots::{Command, ControlError, Pose, RobotState, Twist, TwistLimits};

use crate::DeployError;

use super::rig::Rig;
use super::sight::Sight;

/// From one command to the next: the rate at which a Kinova Gen3 takes them.
pub(super) const TICK: Duration = Duration::from_millis(25);
/// Rate (1/s) at which what is left of the way is covered.
const RATE: f64 = 10.0;
/// Part of that rate at which a turned hand is turned back: things that it pushes turn it.
const TURNING: f64 = 0.2;
/// The furthest that the target may be ahead of the hand (metres): it waits for a hand that is slow
/// or held back. More than the embodiment has for its experts, as commands come late.
const LEAD: f64 = 0.05;

/// Leads an arm where a policy wants its hand, as the policy knows it from its training: the hand
/// follows a target, and each decision moves the target on.
///
/// It reckons where its commands bring the hand, and corrects that only by as much as the hand is
/// further away than it may be. So an arm that obeys late does not swing.
#[derive(Clone, Debug)]
pub(super) struct Pilot {
    limits: TwistLimits,
    /// How the hand is turned.
    rotation: DQuat,
    /// Seconds in which the fingers close.
    closing_time: f64,
    /// How far a full action moves the target in a tick (metres).
    displacement: f64,
    /// Ticks of a decision.
    ticks: usize,
    target: DVec3,
    /// Where the arm's own control has the hand (metres), as far as it follows.
    reference: DVec3,
    /// How the reference moves.
    twist: Twist,
    closing: f64,
    refused: usize,
    /// How long its last decision was reckoned and commanded.
    spent: Duration,
}

impl Pilot {
    /// A pilot of an arm that rests at `start`, for a policy that was trained with `control`.
    pub fn new(arm: &Arm, control: &Control, start: &RobotState) -> Self {
        let seconds = control.decision_seconds();
        let ticks = (seconds / TICK.as_secs_f64()).round().max(1.0);
        let settings = arm.settings();
        Self {
            limits: settings.control.limits,
            rotation: arm.chain().tip(&settings.ready).rotation,
            closing_time: arm.closing_time().unwrap_or(f64::INFINITY),
            displacement: control.displacement / ticks,
            ticks: ticks as usize,
            target: start.tip.position,
            reference: start.tip.position,
            twist: Twist::ZERO,
            closing: start.closing,
            refused: 0,
            spent: Duration::ZERO,
        }
    }

    /// Whether a decision is a whole number of ticks.
    pub fn keeps_time(control: &Control) -> bool {
        let ticks = control.decision_seconds() / TICK.as_secs_f64();
        ticks >= 1.0 && ticks.fract() == 0.0
    }

    /// How often the arm refused a command because it could not follow it, and stood.
    pub fn refused(&self) -> usize {
        self.refused
    }

    /// How long the processor took for the commands of the last decision, without waiting.
    pub fn spent(&self) -> Duration {
        self.spent
    }

    /// Holds `action` for one decision. Components are clipped to `[-1, 1]`. `sight` is told where
    /// the arm is.
    ///
    /// # Errors
    /// [`DeployError::Robot`], [`DeployError::Rig`]; the arm may be moving.
    pub fn decide(
        &mut self,
        rig: &mut dyn Rig,
        sight: &mut Sight,
        action: [f32; ACTION_DIM],
    ) -> Result<(), DeployError> {
        let [x, y, z, finger] = action.map(|value| f64::from(value.clamp(-1.0, 1.0)));
        self.spent = Duration::ZERO;
        for _ in 0..self.ticks {
            let started = Instant::now();
            let state = match rig.state() {
                Err(ControlError::OutOfReach { .. }) => {
                    self.refused += 1;
                    rig.state()?
                }
                state => state?,
            };
            self.move_target(DVec3::new(x, y, z), finger, &state);
            let command = self.command(&state);
            self.twist = self.limits.ramp(self.twist, command.twist, TICK.as_secs_f64());
            self.reference += TICK.as_secs_f64() * self.twist.linear;
            match rig.command(&command) {
                Err(ControlError::OutOfReach { .. }) => self.refused += 1,
                sent => sent?,
            }
            self.spent += started.elapsed();
            rig.wait(TICK).map_err(|source| DeployError::Rig { source })?;
            self.note(rig, sight)?;
        }
        Ok(())
    }

    /// Tells `sight` where the arm is.
    fn note(&mut self, rig: &mut dyn Rig, sight: &mut Sight) -> Result<(), DeployError> {
        match rig.state() {
            Ok(state) => sight.note(rig.now(), state),
            Err(ControlError::OutOfReach { .. }) => self.refused += 1,
            Err(other) => return Err(other.into()),
        }
        Ok(())
    }

    fn move_target(&mut self, way: DVec3, finger: f64, state: &RobotState) {
        let [low, high] = Layout::Symmetric.target_bounds();
        let wanted = (self.target + self.displacement * way).clamp(low, high);
        let hand = state.tip.position;
        let within_lead = |place: DVec3| hand + (place - hand).clamp_length_max(LEAD);
        (self.target, self.reference) = (within_lead(wanted), within_lead(self.reference));
        let closing = self.closing + finger * TICK.as_secs_f64() / self.closing_time;
        self.closing = closing.clamp(0.0, 1.0);
    }

    fn command(&self, state: &RobotState) -> Command {
        let target = Pose { position: self.target, rotation: self.rotation };
        let [_, turn] = state.tip.way_to(&target);
        let way = [self.target - self.reference, TURNING * turn];
        Command { twist: self.limits.towards(way, RATE), closing: self.closing }
    }
}
