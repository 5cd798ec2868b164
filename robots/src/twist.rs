//! Twists (velocities of a rigid body), and limits of a tip's speed and acceleration.

use std::ops::{Add, Mul};

use glam::DVec3;

/// Linear and angular velocity of a tip, along the axes of the world.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Velocity of the tip's origin (m/s).
    pub linear: DVec3,
    /// Angular velocity (rad/s).
    pub angular: DVec3,
}

impl Twist {
    /// Twist of a tip at rest.
    pub const ZERO: Self = Self { linear: DVec3::ZERO, angular: DVec3::ZERO };

    /// Returns a twist with the given linear velocity (m/s) and no rotation.
    pub fn from_linear(linear: DVec3) -> Self {
        Self { linear, angular: DVec3::ZERO }
    }

    /// Returns `true` if all six components and both speeds are finite.
    pub fn is_finite(&self) -> bool {
        // the lengths, because squares of finite components can overflow
        self.linear.length().is_finite() && self.angular.length().is_finite()
    }

    /// Returns the linear components, then the angular ones.
    pub(crate) fn to_array(self) -> [f64; 6] {
        let ([x, y, z], [a, b, c]) = (self.linear.to_array(), self.angular.to_array());
        [x, y, z, a, b, c]
    }

    pub(crate) fn dot(&self, other: &Self) -> f64 {
        self.linear.dot(other.linear) + self.angular.dot(other.angular)
    }
}

impl From<[f64; 6]> for Twist {
    /// Takes three linear components, then three angular ones.
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

/// Maximum speeds and accelerations of a tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwistLimits {
    /// Maximum speed (m/s).
    pub max_speed: f64,
    /// Maximum angular speed (rad/s).
    pub max_angular_speed: f64,
    /// Maximum acceleration (m/s^2).
    pub max_acceleration: f64,
    /// Maximum angular acceleration (rad/s^2).
    pub max_angular_acceleration: f64,
}

impl Default for TwistLimits {
    /// Returns the limits of a Kinova Gen3: 0.5 m/s and 100 degrees per second are its hard limits,
    /// 0.4 m/s^2 and 0.4 rad/s^2 the accelerations that its driver states.
    fn default() -> Self {
        Self {
            max_speed: 0.5,
            max_angular_speed: 1.74,
            max_acceleration: 0.4,
            max_angular_acceleration: 0.4,
        }
    }
}

impl TwistLimits {
    /// Returns the twist with which a tip moves along the remaining displacement (metres) and
    /// rotation vector (radians), as returned by
    /// [`Pose::displacement_to`](crate::Pose::displacement_to).
    ///
    /// The speed is the highest from which the tip can still stop at the end, and at most `rate`
    /// (1/s) times the remaining displacement.
    pub fn twist_towards(&self, [displacement, rotation]: [DVec3; 2], rate: f64) -> Twist {
        let velocity = |remaining: DVec3, speed: f64, acceleration: f64| {
            // v^2 = 2 a s: the speed from which a tip that brakes at `acceleration` stops in time
            let braking = (2.0 * acceleration * remaining.length()).sqrt();
            (rate * remaining).clamp_length_max(speed.min(braking))
        };
        Twist {
            linear: velocity(displacement, self.max_speed, self.max_acceleration),
            angular: velocity(rotation, self.max_angular_speed, self.max_angular_acceleration),
        }
    }

    /// Returns the twist `seconds` after `present`, accelerated towards `wanted` within the limits.
    ///
    /// A `wanted` above the maximum speed is scaled down and keeps its direction.
    pub fn ramp_twist(&self, present: Twist, wanted: Twist, seconds: f64) -> Twist {
        let ramp = |from: DVec3, to: DVec3, speed: f64, acceleration: f64| {
            let change = to.clamp_length_max(speed) - from;
            from + change.clamp_length_max(acceleration * seconds)
        };
        Twist {
            linear: ramp(present.linear, wanted.linear, self.max_speed, self.max_acceleration),
            angular: ramp(
                present.angular,
                wanted.angular,
                self.max_angular_speed,
                self.max_angular_acceleration,
            ),
        }
    }
}
