//! Dry runs: trials in which no command reaches the robot.

use std::fmt::Write as _;
use std::time::Duration;

use envs::embodiments::Arm;
use envs::{ACTION_DIM, Layout};
use inpainting::{CameraCalibration, Intrinsics};
use rl::BoxedEnvError;
use robots::{ArmCommand, ControlError, Robot, RobotState, Twist, TwistController, TwistLimits};

use crate::DeployError;

use super::controller::COMMAND_PERIOD;
use super::latency::{DecisionStage, LatencyProfile};
use super::rig::{PreparedTrial, Rig, TaskVerdict, Trial, fresh_picture};

/// Command for the arm that a dry run did not send.
#[derive(Clone, Debug, PartialEq)]
pub struct UnsentCommand {
    /// Command into which the controller turned the policy's action.
    pub command: ArmCommand,
    /// Velocity that the hand would have had after the tick if the command had been sent. It is
    /// within the arm's limits of speed and acceleration, and zero if the arm would refuse the
    /// command.
    pub resulting_twist: Twist,
    /// Reason for which the arm would refuse the command; `None` if it would accept it.
    pub refusal: Option<String>,
}

/// Result of a dry run: the chosen policy, its actions, the withheld commands, and the times of the
/// stages.
#[derive(Clone, Debug, PartialEq)]
pub struct DryRunReport {
    /// Index of the policy that the learner chose from the first picture.
    pub policy: usize,
    /// `true` if the learner considered the policy to match the task.
    pub policy_fits: bool,
    /// Actions of the policy, one for each decision.
    pub actions: Vec<[f32; ACTION_DIM]>,
    /// Commands that the dry run withheld from the robot, in order; the same number for each
    /// decision.
    pub unsent_commands: Vec<UnsentCommand>,
    /// Times that each stage of a decision took in the dry run.
    pub latencies: LatencyProfile,
}

impl DryRunReport {
    /// Formats the decisions of the dry run with their commands, and a table of times.
    pub fn text(&self) -> String {
        let fits = if self.policy_fits { "fits" } else { "does not fit" };
        let mut text = format!("policy {}, which {fits}\n", self.policy);
        let each = self.unsent_commands.len() / self.actions.len().max(1);
        let commands = self.unsent_commands.chunks(each.max(1));
        for (number, (action, own)) in self.actions.iter().zip(commands).enumerate() {
            text += &decision(number, action, own);
        }
        let refused = self.unsent_commands.iter().filter(|one| one.refusal.is_some());
        // writing to a String cannot fail
        let _ = writeln!(
            text,
            "{} commands were withheld, {} of which the arm would refuse; nothing was sent\n\n\
             stage        times  median (ms)  worst (ms)",
            self.unsent_commands.len(),
            refused.count()
        );
        for stage in DecisionStage::ALL {
            if let Some(times) = self.latencies.median_and_max(stage) {
                let [median, worst] = times.map(|time| 1e3 * time.as_secs_f64());
                let (name, count) = (stage.name(), self.latencies.measurement_count(stage));
                let _ = writeln!(text, "{name:<12} {count:>5}  {median:>11.2}  {worst:>10.2}");
            }
        }
        text
    }
}

fn decision(number: usize, action: &[f32; ACTION_DIM], commands: &[UnsentCommand]) -> String {
    let action = action.map(|part| format!("{part:>6.2}")).concat();
    let Some(last) = commands.last() else {
        return String::new();
    };
    let [x, y, z] = last.resulting_twist.linear.to_array();
    let refusal = commands.iter().find_map(|one| one.refusal.as_deref());
    let refusal = refusal.map_or_else(String::new, |why| format!("; refused: {why}"));
    format!(
        "decision {number:>3}: action {action}; {} commands, the last {x:>6.3} {y:>6.3} {z:>6.3} \
         m/s, {:.3} rad/s, fingers {:.2}{refusal}\n",
        commands.len(),
        last.resulting_twist.angular.length(),
        last.command.gripper_closure,
    )
}

/// Rig that sends nothing to the robot: it passes on pictures and states, and tests and records the
/// commands.
pub(super) struct DryRunRig<'a> {
    rig: &'a mut dyn Rig,
    control: TwistController,
    limits: TwistLimits,
    twist: Twist,
    unsent_commands: Vec<UnsentCommand>,
}

impl<'a> DryRunRig<'a> {
    /// Wraps a rig; `arm` is the model of its robot.
    ///
    /// # Errors
    /// [`DeployError::Robot`] for settings of the arm that its control rejects.
    pub fn new(rig: &'a mut dyn Rig, arm: &Arm) -> Result<Self, DeployError> {
        let settings = arm.settings();
        let (chain, control) = (arm.chain().clone(), settings.control);
        Ok(Self {
            rig,
            control: TwistController::new(chain, &settings.ready_joint_positions, control)?,
            limits: control.limits,
            twist: Twist::ZERO,
            unsent_commands: Vec::new(),
        })
    }

    /// Returns the commands that were not sent to the robot.
    pub fn into_unsent_commands(self) -> Vec<UnsentCommand> {
        self.unsent_commands
    }

    /// Checks that the arm would accept a command in its current state.
    ///
    /// # Errors
    /// Reason for which the arm would refuse the command.
    fn try_out(&mut self, command: &ArmCommand) -> Result<(), ControlError> {
        command.check()?;
        let state = self.rig.state()?;
        // from the measured joints, since the robot does not follow the commands
        self.control.restart(&state.joints)?;
        self.control.command_twist(command.twist)
    }
}

impl Robot for DryRunRig<'_> {
    fn state(&mut self) -> Result<RobotState, ControlError> {
        self.rig.state()
    }

    fn command(&mut self, command: &ArmCommand) -> Result<(), ControlError> {
        let tried = self.try_out(command);
        let seconds = COMMAND_PERIOD.as_secs_f64();
        // a robot stops when it refuses a command
        self.twist = match tried {
            Ok(()) => self.limits.ramp_twist(self.twist, command.twist, seconds),
            Err(_) => Twist::ZERO,
        };
        self.unsent_commands.push(UnsentCommand {
            command: *command,
            resulting_twist: self.twist,
            refusal: tried.as_ref().err().map(ToString::to_string),
        });
        tried
    }

    /// Does not stop the robot, since nothing moved it.
    fn stop(&mut self) -> Result<(), ControlError> {
        self.twist = Twist::ZERO;
        Ok(())
    }
}

impl Rig for DryRunRig<'_> {
    /// Takes a picture of the table and the arm as they are. What the arm hides is treated as empty
    /// table. An observed goal is the middle of the places that the hand can be sent to.
    fn set_up(&mut self, trial: &Trial) -> Result<PreparedTrial, BoxedEnvError> {
        let Intrinsics { width, height, .. } = self.calibration().intrinsics;
        let mut background = vec![0; 3 * width * height];
        // an old picture may show another table
        fresh_picture(self.rig, &mut background).map_err(|error| match error {
            DeployError::Rig { source } => source,
            other => other.into(),
        })?;
        let [low, high] = Layout::Symmetric.hand_target_bounds();
        let is_observed = trial.variant.group.identity_task().parts().goal_observable;
        let goal = is_observed.then(|| low.midpoint(high));
        Ok(PreparedTrial { background, parked_state: self.rig.state()?, goal })
    }

    fn calibration(&self) -> CameraCalibration {
        self.rig.calibration()
    }

    fn trial_independent_calibration(&self) -> CameraCalibration {
        self.rig.trial_independent_calibration()
    }

    fn now(&self) -> Duration {
        self.rig.now()
    }

    fn wait(&mut self, time: Duration) -> Result<(), BoxedEnvError> {
        self.rig.wait(time)
    }

    fn picture(&mut self, rgb: &mut [u8]) -> Result<Duration, BoxedEnvError> {
        self.rig.picture(rgb)
    }

    /// Returns no success, because nothing moved.
    fn verdict(&mut self) -> Result<TaskVerdict, BoxedEnvError> {
        Ok(TaskVerdict::default())
    }
}
