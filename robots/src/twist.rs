//! Velocities of a rigid body, and how fast and how suddenly a tip may move.

use std::ops::{Add, Mul};

use glam::DVec3;

/// Velocity of a tip, with the axes of the world.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Velocity of the tip's origin (m/s).
    pub linear: DVec3,
    /// Angular velocity (rad/s).
    pub angular: DVec3,
}

impl Twist {
    /// No motion.
    pub const ZERO: Self = Self { linear: DVec3::ZERO, angular: DVec3::ZERO };

    /// A motion without turning (m/s).
    pub fn moving(linear: DVec3) -> Self {
        Self { linear, angular: DVec3::ZERO }
    }

    /// Whether all six numbers are finite, and both speeds.
    pub fn is_finite(&self) -> bool {
        self.linear.length().is_finite() && self.angular.length().is_finite()
    }

    /// Linear, then angular.
    pub(crate) fn to_array(self) -> [f64; 6] {
        let ([x, y, z], [a, b, c]) = (self.linear.to_array(), self.angular.to_array());
        [x, y, z, a, b, c]
    }

    pub(crate) fn dot(&self, other: &Self) -> f64 {
        self.linear.dot(other.linear) + self.angular.dot(other.angular)
    }
}

impl From<[f64; 6]> for Twist {
    /// Linear, then angular.
    fn from([x, y, z, a, b, c]: [f64; 6]) -> Self {
        Self { linear: DVec3::new(x, y, z), angular: DVec3::new(a, b, c) }
    }
}

impl Add for Twist {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { linear: self.linear + other.linear, angular: self.angular + other.angular }
    }
}

impl Mul<Twist> for f64 {
    type Output = Twist;

    fn mul(self, twist: Twist) -> Twist {
        Twist { linear: self * twist.linear, angular: self * twist.angular }
    }
}

/// How fast a tip may move, and how fast its velocity may change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwistLimits {
    /// Highest speed (m/s).
    pub speed: f64,
    /// Highest angular speed (rad/s).
    pub angular_speed: f64,
    /// Highest acceleration (m/s^2).
    pub acceleration: f64,
    /// Highest angular acceleration (rad/s^2).
    pub angular_acceleration: f64,
}

impl Default for TwistLimits {
    /// Those of a Kinova Gen3: 0.5 m/s and 100 degrees a second are its hard limits, 0.4 m/s^2 and
    /// 0.4 rad/s^2 the accelerations that its driver states.
    fn default() -> Self {
        Self { speed: 0.5, angular_speed: 1.74, acceleration: 0.4, angular_acceleration: 0.4 }
    }
}

impl TwistLimits {
    /// The twist that leads the tip over `way`, a displacement and a rotation vector as of
    /// [`Pose::way_to`](crate::Pose::way_to). It is as fast as the limits let a tip be that is to
    /// stop at the end, and at most `rate` (1/s) times what is left.
    pub fn towards(&self, [way, turn]: [DVec3; 2], rate: f64) -> Twist {
        let speed = |way: DVec3, speed: f64, acceleration: f64| {
            let left = way.length();
            let braking = (2.0 * acceleration * left).sqrt();
            (rate * way).clamp_length_max(speed.min(braking))
        };
        Twist {
            linear: speed(way, self.speed, self.acceleration),
            angular: speed(turn, self.angular_speed, self.angular_acceleration),
        }
    }

    /// The twist `seconds` after `present`, on the way to `wanted`. Too fast a `wanted` keeps its
    /// direction.
    pub fn ramp(&self, present: Twist, wanted: Twist, seconds: f64) -> Twist {
        let ramp = |present: DVec3, wanted: DVec3, speed: f64, acceleration: f64| {
            let change = wanted.clamp_length_max(speed) - present;
            present + change.clamp_length_max(acceleration * seconds)
        };
        Twist {
            linear: ramp(present.linear, wanted.linear, self.speed, self.acceleration),
            angular: ramp(
                present.angular,
                wanted.angular,
                self.angular_speed,
                self.angular_acceleration,
            ),
        }
    }
}
