//! Cartesian control: converts twists of the tip into positions and velocities of joints.

use std::f64::consts::TAU;

use crate::chain::{Chain, ChainJoint};
use crate::description::{JointMotionKind, JointMotionSpec, check_length};
use crate::error::MAX_NUMBER;
use crate::error::{ControlError, require_finite};
use crate::ik::{
    JointVelocitySolver, OrientationConstraint, check_joint_ranges, range_margins, step_joints,
    tip_miss,
};
use crate::pose::Pose;
use crate::twist::{Twist, TwistLimits};

/// Settings of a [`TwistController`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwistControlSettings {
    /// Maximum speeds and accelerations of the tip.
    pub limits: TwistLimits,
    /// Damping of the least squares (metres or radians per unit of a joint), in [1e-4, 1]. A larger
    /// one moves joints less near singular configurations.
    pub damping: f64,
    /// Rate (1/s), in [0, 40], at which redundant joints return to their posture.
    pub posture_rate: f64,
    /// Rate (1/s), in (0, 40], at which the tip returns to its reference. More than 40 would
    /// overshoot in a step of 25 ms.
    pub correction_rate: f64,
    /// Maximum distance (metres) of the tip from its reference.
    pub tolerance: f64,
    /// Maximum angle (radians) between the tip and its reference.
    pub angular_tolerance: f64,
    /// Time (seconds, in [0, 10]) for which the arm must be able to follow a command; otherwise the
    /// command is rejected. A [`Watchdog`](crate::Watchdog) with this time-out stops the arm before
    /// that time ends.
    pub lookahead_s: f64,
    /// Part of the commanded rotation that the tip follows: an arm with fewer than six joints can
    /// rarely follow all of it. The axis of [`OrientationConstraint::Axis`] keeps to its reference.
    pub orientation: OrientationConstraint,
}

impl Default for TwistControlSettings {
    fn default() -> Self {
        Self {
            limits: TwistLimits::default(),
            damping: 0.02,
            posture_rate: 0.5,
            correction_rate: 5.0,
            tolerance: 0.005,
            angular_tolerance: 0.05,
            lookahead_s: 0.2,
            orientation: OrientationConstraint::Full,
        }
    }
}

impl TwistControlSettings {
    /// Rejects settings out of range.
    ///
    /// # Errors
    /// [`ControlError::InvalidSetting`].
    pub fn check(&self) -> Result<(), ControlError> {
        let limits = &self.limits;
        for (name, value) in [
            ("max_speed", limits.max_speed),
            ("max_angular_speed", limits.max_angular_speed),
            ("max_acceleration", limits.max_acceleration),
            ("max_angular_acceleration", limits.max_angular_acceleration),
            ("tolerance", self.tolerance),
            ("angular_tolerance", self.angular_tolerance),
        ] {
            let in_range = value > 0.0 && value <= MAX_NUMBER;
            check_number(name, value, in_range, "a positive number up to 1e6")?;
        }
        // at a higher rate one step would move beyond the target
        let max_rate = 1.0 / STEP;
        for (name, value, range, expected) in [
            (
                "correction_rate",
                self.correction_rate,
                f64::MIN_POSITIVE..=max_rate,
                "above 0 to 40",
            ),
            ("posture_rate", self.posture_rate, 0.0..=max_rate, "0 to 40"),
            ("damping", self.damping, 1e-4..=1.0, "1e-4 to 1"),
            ("lookahead_s", self.lookahead_s, 0.0..=LONGEST, "0 to 10"),
        ] {
            check_number(name, value, range.contains(&value), expected)?;
        }
        self.orientation.check()
    }
}

fn check_number(
    name: &'static str,
    value: f64,
    in_range: bool,
    expected: &'static str,
) -> Result<(), ControlError> {
    if in_range && value.is_finite() {
        return Ok(());
    }
    Err(ControlError::InvalidSetting { name, value: value.to_string(), expected })
}

/// Longest step (seconds) that is solved at once; longer ticks are divided.
const STEP: f64 = 0.025;
/// Longest tick and longest look-ahead at a command (seconds).
const LONGEST: f64 = 10.0;
/// Speed of the tip (m/s, rad/s) from which joints return to their posture at the full rate. Below
/// it the rate falls to zero, so that an arm at rest moves no joint.
const POSTURE_SPEED: f64 = 0.1;

/// Controller that converts commanded twists into joint positions, tick by tick.
///
/// It holds *references*: target positions of the joints and of the tip. A tick moves the tip's
/// reference by the commanded twist, within the limits of speed and acceleration. Joint references
/// follow by damped least squares, within the ranges and speeds of the joints. If a joint would be
/// too fast, the whole motion is slowed down. Servos, or a simulation, move the arm to the
/// references.
#[derive(Clone, Debug, PartialEq)]
pub struct TwistController {
    chain: Chain,
    settings: TwistControlSettings,
    posture: Vec<f64>,
    configuration: Vec<f64>,
    velocities: Vec<f64>,
    solver: JointVelocitySolver,
    /// Target pose of the tip in the world.
    reference: Pose,
    wanted: Twist,
    twist: Twist,
}

impl TwistController {
    /// Creates a controller at rest in `posture` `[len]`, to which redundant joints return.
    ///
    /// # Errors
    /// [`ControlError::InvalidSetting`], [`ControlError::JointOutOfRange`],
    /// [`ControlError::ReversedRange`], [`ControlError::MissingSpeed`].
    ///
    /// # Panics
    /// If `posture` is not as long as the chain.
    pub fn new(
        chain: Chain,
        posture: &[f64],
        settings: TwistControlSettings,
    ) -> Result<Self, ControlError> {
        let joints = chain.joints().len();
        check_length("posture", posture.len(), joints);
        settings.check()?;
        check_joint_ranges(&chain, posture)?;
        let unlimited = chain.joints().iter().filter(|joint| joint.motion.max_speed.is_none());
        let unlimited: Vec<String> = unlimited.map(|joint| joint.name.clone()).collect();
        if !unlimited.is_empty() {
            return Err(ControlError::MissingSpeed { joints: unlimited });
        }
        Ok(Self {
            reference: chain.tip_pose(posture),
            posture: posture.to_vec(),
            configuration: posture.to_vec(),
            velocities: vec![0.0; joints],
            solver: JointVelocitySolver::new(joints, settings.orientation),
            wanted: Twist::ZERO,
            twist: Twist::ZERO,
            chain,
            settings,
        })
    }

    /// Restarts the controller at rest in `configuration` `[len]`, for instance the measured one.
    ///
    /// # Errors
    /// [`ControlError::JointOutOfRange`]; the controller is unchanged then.
    ///
    /// # Panics
    /// If `configuration` is not as long as the chain.
    pub fn restart(&mut self, configuration: &[f64]) -> Result<(), ControlError> {
        check_length("configuration", configuration.len(), self.configuration.len());
        check_joint_ranges(&self.chain, configuration)?;
        self.configuration.copy_from_slice(configuration);
        self.stop();
        Ok(())
    }

    /// Returns the controlled chain.
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// Returns the reference positions of the joints `[len]` (radians, metres).
    pub fn joint_positions(&self) -> &[f64] {
        &self.configuration
    }

    /// Returns the reference velocities of the joints `[len]` (rad/s, m/s).
    pub fn joint_velocities(&self) -> &[f64] {
        &self.velocities
    }

    /// Returns the pose of the tip in the world at the reference positions of the joints.
    pub fn tip_pose(&self) -> Pose {
        self.chain.tip_pose(&self.configuration)
    }

    /// Returns the twist with which the tip's reference moves now, along the axes of the world.
    pub fn current_twist(&self) -> Twist {
        self.twist
    }

    /// Sets the twist (along the axes of the world) that the tip accelerates to and keeps. A twist
    /// above the maximum speed is slowed down to it.
    ///
    /// # Errors
    /// [`ControlError::NotFinite`]; [`ControlError::CannotFollow`] if the arm could not follow for
    /// [`TwistControlSettings::lookahead_s`]. The arm is stopped then.
    pub fn command_twist(&mut self, twist: Twist) -> Result<(), ControlError> {
        let checked = check_twist(&twist).and_then(|()| self.look_ahead(twist));
        if checked.is_err() {
            self.stop();
        } else {
            self.wanted = twist;
        }
        checked
    }

    /// Simulates `twist` on a copy for [`TwistControlSettings::lookahead_s`], and fails if a tick
    /// fails.
    fn look_ahead(&self, twist: Twist) -> Result<(), ControlError> {
        let mut ahead = self.clone();
        ahead.wanted = twist;
        let steps = (self.settings.lookahead_s / STEP).ceil() as usize;
        (0..steps).try_for_each(|_| ahead.tick(STEP))
    }

    /// Stops tip and joints at the reference positions of the joints.
    pub fn stop(&mut self) {
        self.wanted = Twist::ZERO;
        self.twist = Twist::ZERO;
        self.velocities.fill(0.0);
        // drops the tip's lag, which the next command would otherwise correct
        self.reference = self.tip_pose();
    }

    /// Advances the references of joints and tip by `seconds`, in (0, 10], in steps of at most 25
    /// ms.
    ///
    /// # Errors
    /// [`ControlError::CannotFollow`] if the arm cannot follow the tip's reference because it is at
    /// the end of its reach or of the ranges of its joints. [`ControlError::InvalidSetting`] for a
    /// time out of range, [`ControlError::NotFinite`] if the solved joint velocities are not
    /// finite. The arm is stopped then.
    pub fn tick(&mut self, seconds: f64) -> Result<(), ControlError> {
        let in_range = seconds > 0.0 && seconds <= LONGEST;
        let checked = check_number("seconds", seconds, in_range, "a positive number up to 10");
        let outcome = checked.and_then(|()| {
            let steps = (seconds / STEP).ceil();
            (0..steps as usize).try_for_each(|_| self.follow(seconds / steps))
        });
        if outcome.is_err() {
            self.stop();
        }
        outcome
    }

    fn follow(&mut self, seconds: f64) -> Result<(), ControlError> {
        let twist = self.settings.limits.ramp_twist(self.twist, self.wanted, seconds);
        // a twist that is reversed may pass zero
        if twist == Twist::ZERO && self.wanted == Twist::ZERO {
            self.stop();
            return Ok(());
        }
        self.solve(twist, seconds);
        self.check_solved()?;
        // joints and tip are slowed down alike, so the tip stays on its path
        let scale = self.speed_scale();
        self.twist = scale * twist;
        self.reference = advanced(&self.reference, &self.twist, seconds);
        for (velocity, solved) in self.velocities.iter_mut().zip(self.solver.joint_velocities()) {
            *velocity = scale * solved;
        }
        step_joints(self.chain.joints(), &mut self.configuration, &self.velocities, seconds);
        self.check_lag()
    }

    /// Solves for the joint velocities of `twist`, without limits on their speeds.
    fn solve(&mut self, twist: Twist, seconds: f64) {
        let Self { chain, settings, configuration, posture, reference, solver, .. } = self;
        let (tip, orientation) = (chain.tip_pose(configuration), settings.orientation);
        let correction = settings.correction_rate * orientation.pose_error(&tip, reference);
        let speed = twist.linear.length().max(twist.angular.length());
        let rate = settings.posture_rate * (speed / POSTURE_SPEED).min(1.0);
        solver.solve(
            chain,
            configuration,
            orientation.constrained(&tip, twist) + correction,
            settings.damping,
            |joint| {
                let displacement = posture[joint] - configuration[joint];
                rate * shortest(&chain.joints()[joint].motion, displacement)
            },
            |joint| {
                let room = range_margins(&chain.joints()[joint], configuration[joint]);
                room.map(|distance| distance / seconds)
            },
        );
    }

    fn check_solved(&self) -> Result<(), ControlError> {
        let velocities = self.solver.joint_velocities();
        let finite = velocities.iter().all(|velocity| velocity.is_finite());
        let what = "the solved velocity of the joints";
        require_finite(finite, what, format_args!("{velocities:?}"))
    }

    /// Returns the factor, in [0, 1], by which the solved velocities are scaled so that no joint is
    /// too fast.
    fn speed_scale(&self) -> f64 {
        let joints = self.chain.joints().iter().zip(self.solver.joint_velocities());
        let factor = |(joint, velocity): (&ChainJoint, &f64)| {
            joint.motion.max_speed.map_or(1.0, |speed| speed / velocity.abs())
        };
        // a joint at rest has the factor infinity, which the fold ignores
        joints.map(factor).fold(1.0, f64::min)
    }

    fn check_lag(&self) -> Result<(), ControlError> {
        let lag = self.settings.orientation.pose_error(&self.tip_pose(), &self.reference);
        let near = lag.linear.length() <= self.settings.tolerance
            && lag.angular.length() <= self.settings.angular_tolerance;
        if near {
            return Ok(());
        }
        let orientation = self.settings.orientation;
        let miss = tip_miss(&self.chain, orientation, &self.configuration, &self.reference);
        Err(ControlError::CannotFollow { miss })
    }
}

/// Rejects a twist that is not finite.
pub(crate) fn check_twist(twist: &Twist) -> Result<(), ControlError> {
    let Twist { linear, angular } = twist;
    let value = format_args!("linear {linear}, angular {angular}");
    require_finite(twist.is_finite(), "the commanded twist", value)
}

/// Returns `displacement`, less whole turns of a hinge without limits: in (-pi, pi] for such a one.
fn shortest(motion: &JointMotionSpec, displacement: f64) -> f64 {
    match (motion.kind, motion.range) {
        (JointMotionKind::Hinge, None) => displacement - TAU * (displacement / TAU - 0.5).ceil(),
        _ => displacement,
    }
}

/// Returns `pose` after `seconds` of motion by `twist`.
fn advanced(pose: &Pose, twist: &Twist, seconds: f64) -> Pose {
    let turn = glam::DQuat::from_scaled_axis(seconds * twist.angular);
    Pose {
        position: pose.position + seconds * twist.linear,
        rotation: (turn * pose.rotation).normalize(),
    }
}
