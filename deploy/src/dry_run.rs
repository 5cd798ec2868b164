//! Rehearsals: all that a trial does, and nothing moves.

use std::fmt::Write as _;
use std::time::Duration;

use envs::ACTION_DIM;
use envs::carriers::Arm;
use inpainting::Calibration;
use rl::BoxError;
use robots::{CartesianControl, Command, ControlError, Robot, RobotState, Twist, TwistLimits};

use crate::DeployError;

use super::pilot::TICK;
use super::rig::{Rig, SetUp, Trial, Verdict, fresh_picture};
use super::stages::{Stage, Stages};

/// A command that was not sent.
#[derive(Clone, Debug, PartialEq)]
pub struct Withheld {
    /// The command.
    pub command: Command,
    /// How the hand would move after the tick, by the arm's limits of speed and acceleration.
    pub twist: Twist,
    /// Why the arm would refuse it, where it would.
    pub refusal: Option<String>,
}

/// What a rehearsal came to.
#[derive(Clone, Debug, PartialEq)]
pub struct Rehearsal {
    /// The policy that the learner chose.
    pub policy: usize,
    /// Whether it takes the task for one of that policy's.
    pub fits: bool,
    /// What the policy decided.
    pub actions: Vec<[f32; ACTION_DIM]>,
    /// The commands, the same number of each decision.
    pub withheld: Vec<Withheld>,
    /// How long everything took.
    pub stages: Stages,
}

impl Rehearsal {
    /// Decisions with what they would send, and a table of times.
    pub fn text(&self) -> String {
        let fits = if self.fits { "fits" } else { "does not fit" };
        let mut text = format!("policy {}, which {fits}\n", self.policy);
        let each = self.withheld.len() / self.actions.len().max(1);
        let commands = self.withheld.chunks(each.max(1));
        for (number, (action, commands)) in self.actions.iter().zip(commands).enumerate() {
            text += &decision(number, action, commands);
        }
        let refused = self.withheld.iter().filter(|one| one.refusal.is_some());
        // writing to a String cannot fail
        let _ = writeln!(
            text,
            "{} commands were withheld, {} of which the arm would refuse; nothing was sent\n\n\
             stage        times  median (ms)  worst (ms)",
            self.withheld.len(),
            refused.count()
        );
        for stage in Stage::ALL {
            if let Some(times) = self.stages.times(stage) {
                let [median, worst] = times.map(|time| 1e3 * time.as_secs_f64());
                let (name, count) = (stage.name(), self.stages.count(stage));
                let _ = writeln!(text, "{name:<12} {count:>5}  {median:>11.2}  {worst:>10.2}");
            }
        }
        text
    }
}

fn decision(number: usize, action: &[f32; ACTION_DIM], commands: &[Withheld]) -> String {
    let action = action.map(|part| format!("{part:>6.2}")).concat();
    let Some(last) = commands.last() else {
        return String::new();
    };
    let [x, y, z] = last.twist.linear.to_array();
    let refusal = commands.iter().find_map(|one| one.refusal.as_deref());
    let refusal = refusal.map_or_else(String::new, |why| format!("; refused: {why}"));
    format!(
        "decision {number:>3}: action {action}; {} commands, the last {x:>6.3} {y:>6.3} {z:>6.3} \
         m/s, {:.3} rad/s, fingers {:.2}{refusal}\n",
        commands.len(),
        last.twist.angular.length(),
        last.command.closing,
    )
}

/// A rig whose robot is told nothing, and whose table nobody sets.
pub(super) struct DryRun<'a> {
    rig: &'a mut dyn Rig,
    control: CartesianControl,
    limits: TwistLimits,
    twist: Twist,
    withheld: Vec<Withheld>,
}

impl<'a> DryRun<'a> {
    /// # Errors
    /// None but those of the arm's own settings.
    pub fn new(rig: &'a mut dyn Rig, arm: &Arm) -> Result<Self, DeployError> {
        let settings = arm.settings();
        let (chain, control) = (arm.chain().clone(), settings.control);
        Ok(Self {
            rig,
            control: CartesianControl::new(chain, &settings.ready, control)?,
            limits: control.limits,
            twist: Twist::ZERO,
            withheld: Vec::new(),
        })
    }

    /// The commands that were not sent.
    pub fn into_withheld(self) -> Vec<Withheld> {
        self.withheld
    }

    /// Whether the arm would take a command where it stands.
    fn try_out(&mut self, command: &Command) -> Result<(), ControlError> {
        command.check()?;
        let state = self.rig.state()?;
        self.control.restart(&state.joints)?;
        self.control.command(command.twist)
    }
}

impl Robot for DryRun<'_> {
    fn state(&mut self) -> Result<RobotState, ControlError> {
        self.rig.state()
    }

    fn command(&mut self, command: &Command) -> Result<(), ControlError> {
        let tried = self.try_out(command);
        let seconds = TICK.as_secs_f64();
        self.twist = match tried {
            Ok(()) => self.limits.ramp(self.twist, command.twist, seconds),
            Err(_) => Twist::ZERO,
        };
        self.withheld.push(Withheld {
            command: *command,
            twist: self.twist,
            refusal: tried.as_ref().err().map(ToString::to_string),
        });
        tried
    }

    /// Nothing moves, so nothing is stopped.
    fn stop(&mut self) -> Result<(), ControlError> {
        self.twist = Twist::ZERO;
        Ok(())
    }
}

impl Rig for DryRun<'_> {
    /// The table as it is, with the arm where it is, in a picture as fresh as those of decisions.
    /// What the arm hides is taken to be empty table.
    fn set_up(&mut self, _: &Trial) -> Result<SetUp, BoxError> {
        let inside = self.calibration().intrinsics;
        let mut background = vec![0; 3 * inside.width * inside.height];
        fresh_picture(self.rig, &mut background).map_err(|error| match error {
            DeployError::Rig { source } => source,
            other => other.into(),
        })?;
        Ok(SetUp { background, parked: self.rig.state()?, goal: None })
    }

    fn calibration(&self) -> Calibration {
        self.rig.calibration()
    }

    fn standing_calibration(&self) -> Calibration {
        self.rig.standing_calibration()
    }

    fn now(&self) -> Duration {
        self.rig.now()
    }

    fn wait(&mut self, time: Duration) -> Result<(), BoxError> {
        self.rig.wait(time)
    }

    fn picture(&mut self, rgb: &mut [u8]) -> Result<Duration, BoxError> {
        self.rig.picture(rgb)
    }

    /// Nobody is asked.
    fn verdict(&mut self) -> Result<Verdict, BoxError> {
        Ok(Verdict::default())
    }
}
