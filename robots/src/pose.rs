//! Rigid transforms between frames.

use std::ops::Mul;

use glam::{DQuat, DVec3, EulerRot};

/// Position and rotation of one frame in another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Origin of the frame (metres).
    pub position: DVec3,
    /// Rotation of the frame, a unit quaternion.
    pub rotation: DQuat,
}

/// Length of a rotation, as an error states it.
pub(crate) const UNIT_LENGTH: &str = "1, the length of a unit quaternion";

/// Returns `true` if `length` is that of a unit quaternion, up to rounding.
pub(crate) fn is_unit_length(length: f64) -> bool {
    (length - 1.0).abs() < 1e-6
}

impl Pose {
    /// Identity transform.
    pub const IDENTITY: Self = Self { position: DVec3::ZERO, rotation: DQuat::IDENTITY };

    /// Returns a frame with its origin at `position` (metres) and no rotation.
    pub fn from_position(position: DVec3) -> Self {
        Self { position, rotation: DQuat::IDENTITY }
    }

    /// Converts URDF's `<origin>`: metres, and roll, pitch and yaw (radians) about fixed axes, in
    /// this order.
    pub fn from_xyz_rpy(xyz: [f64; 3], [roll, pitch, yaw]: [f64; 3]) -> Self {
        Self {
            position: DVec3::from_array(xyz),
            // roll, pitch, yaw about fixed axes are yaw, pitch, roll about moving ones
            rotation: DQuat::from_euler(EulerRot::ZYX, yaw, pitch, roll),
        }
    }

    /// Transforms a point of this frame into the frame that the pose is given in.
    pub fn transform_point(&self, point: DVec3) -> DVec3 {
        self.position + self.rotation * point
    }

    /// Returns the displacement (metres) and the shortest rotation vector (radians) from this pose
    /// to `target`, both along the axes of the frame that the poses are given in.
    pub fn displacement_to(&self, target: &Self) -> [DVec3; 2] {
        let turn = target.rotation * self.rotation.conjugate();
        // q and -q are one rotation; w >= 0 has the angle of at most pi
        let shorter = if turn.w < 0.0 { -turn } else { turn };
        [target.position - self.position, shorter.to_scaled_axis()]
    }
}

impl Mul for Pose {
    type Output = Self;

    /// Composes transforms: `inner`, given in the frame `self`, in the frame that `self` is in.
    fn mul(self, inner: Self) -> Self {
        Self {
            position: self.transform_point(inner.position),
            rotation: (self.rotation * inner.rotation).normalize(),
        }
    }
}
