//! Cartesian control: twists of the tip become positions and velocities of joints.

use std::f64::consts::TAU;
use std::ops::RangeInclusive;

use crate::chain::{Chain, ChainJoint};
use crate::description::{Motion, MotionKind, check_length};
use crate::error::LARGEST;
use crate::error::{ControlError, require_finite};
use crate::ik::{DampedLeastSquares, check_posture, error, out_of_reach, room, step};
use crate::pose::Pose;
use crate::twist::{Twist, TwistLimits};

/// How twists become joint motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlSettings {
    /// How fast and how suddenly the tip moves.
    pub limits: TwistLimits,
    /// Damping of the least squares (metres or radians per unit of a joint). More of it moves
    /// joints less near singular configurations. 1e-4 to 1.
    pub damping: f64,
    /// Rate (1/s) at which joints go back to their posture, where the tip leaves a choice. 0 to 40.
    pub posture_rate: f64,
    /// Rate (1/s) at which the tip goes back to where it should be; 40 at most. More would
    /// overshoot in a step of 25 ms.
    pub correction_rate: f64,
    /// How far (metres) the tip may be from where it should be.
    pub tolerance: f64,
    /// How far (radians) the tip may be turned from how it should be.
    pub angular_tolerance: f64,
    /// How long (seconds, 10 at most) the arm must be able to follow a command, or the command is
    /// refused. A [`Watchdog`](crate::Watchdog) with this time-out stops the arm before the end.
    pub horizon: f64,
}

impl Default for ControlSettings {
    fn default() -> Self {
        Self {
            limits: TwistLimits::default(),
            damping: 0.02,
            posture_rate: 0.5,
            correction_rate: 5.0,
            tolerance: 0.005,
            angular_tolerance: 0.05,
            horizon: 0.2,
        }
    }
}

impl ControlSettings {
    /// Refuses settings out of range.
    ///
    /// # Errors
    /// [`ControlError::Setting`].
    pub fn check(&self) -> Result<(), ControlError> {
        for (name, value) in self.positive() {
            let in_range = value > 0.0 && value <= LARGEST;
            check_number(name, value, in_range, "a positive number up to 1e6")?;
        }
        for (name, value, range, expected) in self.ranges() {
            check_number(name, value, range.contains(&value), expected)?;
        }
        Ok(())
    }

    fn positive(&self) -> [(&'static str, f64); 7] {
        let limits = &self.limits;
        [
            ("speed", limits.speed),
            ("angular_speed", limits.angular_speed),
            ("acceleration", limits.acceleration),
            ("angular_acceleration", limits.angular_acceleration),
            ("correction_rate", self.correction_rate),
            ("tolerance", self.tolerance),
            ("angular_tolerance", self.angular_tolerance),
        ]
    }

    fn ranges(&self) -> [(&'static str, f64, RangeInclusive<f64>, &'static str); 4] {
        let rates = 0.0..=1.0 / STEP;
        let correction = self.correction_rate;
        [
            ("correction_rate", correction, rates.clone(), "40 at most"),
            ("posture_rate", self.posture_rate, rates, "0 to 40"),
            ("damping", self.damping, 1e-4..=1.0, "1e-4 to 1"),
            ("horizon", self.horizon, 0.0..=LONGEST, "0 to 10"),
        ]
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
    Err(ControlError::Setting { name, value: value.to_string(), expected })
}

/// Longest step (seconds) that is solved at once.
const STEP: f64 = 0.025;
/// Longest tick and longest look ahead at a command (seconds).
const LONGEST: f64 = 10.0;
/// Speed of the tip (m/s, rad/s) from which on joints go back to their posture at the full rate. An
/// arm that stands still moves no joint.
const POSTURE_SPEED: f64 = 0.1;

/// Turns commanded twists into joint positions, tick by tick.
///
/// It holds *references*: where joints and tip should be. A tick moves the tip's reference by the
/// commanded twist, within the limits of speed and acceleration. Joint references follow by damped
/// least squares, within the ranges and speeds of the joints. Where a joint would be too fast, the
/// whole motion is slowed down. Servos, or a simulation, move the arm to the references.
#[derive(Clone, Debug, PartialEq)]
pub struct CartesianControl {
    chain: Chain,
    settings: ControlSettings,
    posture: Vec<f64>,
    configuration: Vec<f64>,
    velocities: Vec<f64>,
    solver: DampedLeastSquares,
    /// Where the tip should be.
    reference: Pose,
    wanted: Twist,
    twist: Twist,
}

impl CartesianControl {
    /// An arm at rest in `posture` `[len]`, to which it returns where its tip leaves a choice.
    ///
    /// # Errors
    /// [`ControlError::Setting`], [`ControlError::Posture`].
    ///
    /// # Panics
    /// Where `posture` is not as long as the chain.
    pub fn new(
        chain: Chain,
        posture: &[f64],
        settings: ControlSettings,
    ) -> Result<Self, ControlError> {
        let joints = chain.joints().len();
        check_length("posture", posture.len(), joints);
        settings.check()?;
        check_posture(&chain, posture)?;
        Ok(Self {
            reference: chain.tip(posture),
            posture: posture.to_vec(),
            configuration: posture.to_vec(),
            velocities: vec![0.0; joints],
            solver: DampedLeastSquares::new(joints),
            wanted: Twist::ZERO,
            twist: Twist::ZERO,
            chain,
            settings,
        })
    }

    /// Starts again at rest from `configuration` `[len]`, for instance where the arm was found.
    ///
    /// # Errors
    /// [`ControlError::Posture`], and nothing has changed.
    ///
    /// # Panics
    /// Where `configuration` is not as long as the chain.
    pub fn restart(&mut self, configuration: &[f64]) -> Result<(), ControlError> {
        check_length("configuration", configuration.len(), self.configuration.len());
        check_posture(&self.chain, configuration)?;
        self.configuration.copy_from_slice(configuration);
        self.stop();
        Ok(())
    }

    /// The chain that is controlled.
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// Where the joints should be `[len]` (radians, metres).
    pub fn joints(&self) -> &[f64] {
        &self.configuration
    }

    /// How fast the joints should move `[len]` (1/s).
    pub fn velocities(&self) -> &[f64] {
        &self.velocities
    }

    /// Where the tip is when the joints are where they should be (world).
    pub fn tip(&self) -> Pose {
        self.chain.tip(&self.configuration)
    }

    /// The twist of the last tick (world).
    pub fn twist(&self) -> Twist {
        self.twist
    }

    /// Sets the twist (world) that the tip shall come to and keep. One that is too fast is slowed
    /// down to the limit.
    ///
    /// # Errors
    /// [`ControlError::NotFinite`]; [`ControlError::OutOfReach`] where the arm could not follow for
    /// [`ControlSettings::horizon`]. The arm is stopped then.
    pub fn command(&mut self, twist: Twist) -> Result<(), ControlError> {
        let checked = check_twist(&twist).and_then(|()| self.look_ahead(twist));
        if checked.is_err() {
            self.stop();
        } else {
            self.wanted = twist;
        }
        checked
    }

    /// Follows `twist` in thought.
    fn look_ahead(&self, twist: Twist) -> Result<(), ControlError> {
        let mut ahead = self.clone();
        ahead.wanted = twist;
        let looks = (self.settings.horizon / STEP).ceil() as usize;
        (0..looks).try_for_each(|_| ahead.tick(STEP))
    }

    /// Holds tip and joints where they are.
    pub fn stop(&mut self) {
        self.wanted = Twist::ZERO;
        self.twist = Twist::ZERO;
        self.velocities.fill(0.0);
        self.reference = self.tip();
    }

    /// Moves the references on by `seconds`, 10 at most, in steps of 25 ms or less.
    ///
    /// # Errors
    /// [`ControlError::OutOfReach`] where the arm cannot follow its tip: it is at the end of its
    /// reach, or of the ranges of its joints. [`ControlError::Setting`] for a time out of range,
    /// [`ControlError::NotFinite`] where joints are beyond all numbers. The arm is stopped then.
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
        let twist = self.settings.limits.ramp(self.twist, self.wanted, seconds);
        if twist == Twist::ZERO {
            self.stop();
            return Ok(());
        }
        self.solve(twist, seconds);
        self.check_solved()?;
        let scale = self.slowing();
        self.twist = scale * twist;
        self.reference = moved(&self.reference, &self.twist, seconds);
        for (velocity, solved) in self.velocities.iter_mut().zip(self.solver.velocities()) {
            *velocity = scale * solved;
        }
        step(self.chain.joints(), &mut self.configuration, &self.velocities, seconds);
        self.check_lag()
    }

    /// Solves for the joint velocities of `twist`, which may be too fast.
    fn solve(&mut self, twist: Twist, seconds: f64) {
        let Self { chain, settings, configuration, posture, reference, solver, .. } = self;
        let correction = settings.correction_rate * error(&chain.tip(configuration), reference);
        let speed = twist.linear.length().max(twist.angular.length());
        let rate = settings.posture_rate * (speed / POSTURE_SPEED).min(1.0);
        solver.solve(
            chain,
            configuration,
            twist + correction,
            settings.damping,
            |joint| {
                let way = posture[joint] - configuration[joint];
                rate * nearest(&chain.joints()[joint].motion, way)
            },
            |joint| {
                let room = room(&chain.joints()[joint], configuration[joint]);
                room.map(|way| way / seconds)
            },
        );
    }

    fn check_solved(&self) -> Result<(), ControlError> {
        let velocities = self.solver.velocities();
        let finite = velocities.iter().all(|velocity| velocity.is_finite());
        let what = "the solved velocity of the joints";
        require_finite(finite, what, format_args!("{velocities:?}"))
    }

    /// The part of the solved velocities at which no joint is too fast.
    fn slowing(&self) -> f64 {
        let joints = self.chain.joints().iter().zip(self.solver.velocities());
        let part = |(joint, velocity): (&ChainJoint, &f64)| joint.motion.speed / velocity.abs();
        // where a joint stands still, the part is infinite
        joints.map(part).fold(1.0, f64::min)
    }

    fn check_lag(&self) -> Result<(), ControlError> {
        let lag = error(&self.tip(), &self.reference);
        let near = lag.linear.length() <= self.settings.tolerance
            && lag.angular.length() <= self.settings.angular_tolerance;
        if near {
            return Ok(());
        }
        Err(out_of_reach(&self.chain, &self.configuration, &self.reference))
    }
}

/// Refuses a twist that holds anything but numbers.
pub(crate) fn check_twist(twist: &Twist) -> Result<(), ControlError> {
    let Twist { linear, angular } = twist;
    let value = format_args!("linear {linear}, angular {angular}");
    require_finite(twist.is_finite(), "the commanded twist", value)
}

/// The shorter way to the same place, where whole turns make no difference.
fn nearest(motion: &Motion, way: f64) -> f64 {
    match (motion.kind, motion.range) {
        (MotionKind::Hinge, None) => way - TAU * (way / TAU - 0.5).ceil(),
        _ => way,
    }
}

/// Where a frame is after `seconds` of a twist.
fn moved(pose: &Pose, twist: &Twist, seconds: f64) -> Pose {
    let turn = glam::DQuat::from_scaled_axis(seconds * twist.angular);
    Pose {
        position: pose.position + seconds * twist.linear,
        rotation: (turn * pose.rotation).normalize(),
    }
}
