//! Where a frame is, and how it is turned.

use std::ops::Mul;

use glam::{DQuat, DVec3, EulerRot};

/// Position and rotation of one frame in another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// The frame's origin (metres).
    pub position: DVec3,
    /// The frame's rotation, a unit quaternion.
    pub rotation: DQuat,
}

impl Pose {
    /// The same frame.
    pub const IDENTITY: Self = Self { position: DVec3::ZERO, rotation: DQuat::IDENTITY };

    /// A frame with parallel axes, its origin at `position` (metres).
    pub fn at(position: DVec3) -> Self {
        Self { position, rotation: DQuat::IDENTITY }
    }

    /// URDF's `<origin>`: roll, pitch and yaw (radians) about fixed axes, in this order.
    pub fn from_xyz_rpy(xyz: [f64; 3], [roll, pitch, yaw]: [f64; 3]) -> Self {
        Self {
            position: DVec3::from_array(xyz),
            rotation: DQuat::from_euler(EulerRot::ZYX, yaw, pitch, roll),
        }
    }

    /// A point of this frame in the frame that the pose is in.
    pub fn point(&self, point: DVec3) -> DVec3 {
        self.position + self.rotation * point
    }

    /// The way from this pose to `target`: a displacement (metres), and the rotation vector
    /// (radians) of the shorter turn. Both have the axes of the frame that the poses are in.
    pub fn way_to(&self, target: &Self) -> [DVec3; 2] {
        let turn = target.rotation * self.rotation.conjugate();
        let shorter = if turn.w < 0.0 { -turn } else { turn };
        [target.position - self.position, shorter.to_scaled_axis()]
    }
}

impl Mul for Pose {
    type Output = Self;

    /// The pose of `inner`, given in the frame `self`, in the frame that `self` is in.
    fn mul(self, inner: Self) -> Self {
        Self {
            position: self.point(inner.position),
            rotation: (self.rotation * inner.rotation).normalize(),
        }
    }
}
