//! Mirror planes, and the maps by which they relate the frames of two bodies.

use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Mirror plane in the world: all points p with `normal` · p = `offset`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MirrorPlane {
    /// Unit vector across the plane, which points to the left side.
    pub normal: [f64; 3],
    /// Distance of the plane from the world's origin along the normal (metres).
    #[serde(default)]
    pub offset: f64,
}

impl MirrorPlane {
    /// Returns `true` for a normal of length 1 and a finite offset.
    pub(crate) fn is_valid(&self) -> bool {
        let excess = DVec3::from_array(self.normal).length() - 1.0;
        excess.abs() <= 1e-6 && self.offset.is_finite()
    }

    /// Returns the signed distance of a point from the plane (metres), positive on the left.
    pub(crate) fn distance(&self, point: DVec3) -> f64 {
        DVec3::from_array(self.normal).dot(point) - self.offset
    }

    /// Returns the map of points in the world to their mirror images.
    pub(crate) fn mirror(&self) -> Mirror {
        let normal = DVec3::from_array(self.normal);
        let [x, y, z] = (2.0 * normal).to_array();
        let turn = DMat3::IDENTITY - DMat3::from_cols(x * normal, y * normal, z * normal);
        Mirror { turn, shift: 2.0 * self.offset * normal }
    }
}

/// Map of points in the frame of a body to their mirror images in the frame of its counterpart.
#[derive(Clone, Copy)]
pub(crate) struct Mirror {
    /// Orthogonal matrix with determinant -1.
    pub turn: DMat3,
    /// Image of the origin (metres).
    pub shift: DVec3,
}

impl Mirror {
    pub(crate) fn point(&self, point: DVec3) -> DVec3 {
        self.turn * point + self.shift
    }

    pub(crate) fn direction(&self, direction: DVec3) -> DVec3 {
        self.turn * direction
    }

    /// Returns the mirror image of an axis of rotation, an angular velocity or a torque.
    pub(crate) fn axial(&self, axis: DVec3) -> DVec3 {
        -(self.turn * axis)
    }

    pub(crate) fn inverse(&self) -> Self {
        let turn = self.turn.transpose();
        Self { turn, shift: -(turn * self.shift) }
    }

    pub(crate) fn tensor(&self, tensor: DMat3) -> DMat3 {
        self.turn * tensor * self.turn.transpose()
    }
}

/// Converts MuJoCo's quaternion (w, x, y, z) to one of `glam`.
pub(crate) fn quat(values: &[f64]) -> DQuat {
    DQuat::from_xyzw(values[1], values[2], values[3], values[0])
}

/// Returns the elements (w, x, y, z) of a rotation.
pub(crate) fn quat_values(rotation: DQuat) -> [f64; 4] {
    [rotation.w, rotation.x, rotation.y, rotation.z]
}

/// Returns the eigenvalues of a symmetric matrix, and the rotation that turns the coordinate axes
/// to its principal axes (Jacobi's method; Golub and Van Loan, "Matrix Computations", section 8.5).
pub(crate) fn principal(mut tensor: DMat3) -> (DVec3, DQuat) {
    let mut axes = DQuat::IDENTITY;
    for _ in 0..50 {
        let off = [(1, 2), (2, 0), (0, 1)].map(|(row, col)| tensor.col(col)[row]);
        let Some(at) = (0..3).max_by(|&a, &b| off[a].abs().total_cmp(&off[b].abs())) else { break };
        let (p, q) = [(1, 2), (2, 0), (0, 1)][at];
        let angle = 0.5 * (2.0 * off[at]).atan2(tensor.col(p)[p] - tensor.col(q)[q]);
        let turn = DQuat::from_axis_angle(DVec3::AXES[at], angle);
        let matrix = DMat3::from_quat(turn);
        tensor = matrix.transpose() * tensor * matrix;
        axes *= turn;
    }
    (DVec3::new(tensor.x_axis.x, tensor.y_axis.y, tensor.z_axis.z), axes.normalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mirror_image_is_as_far_on_the_other_side() {
        let plane = MirrorPlane { normal: [0.0, 0.6, 0.8], offset: 0.3 };
        let (mirror, point) = (plane.mirror(), DVec3::new(1.0, 2.0, 3.0));
        let image = mirror.point(point);
        assert!((plane.distance(point) + plane.distance(image)).abs() < 1e-12);
        assert!((mirror.point(image) - point).length() < 1e-12);
        assert!((mirror.turn.determinant() + 1.0).abs() < 1e-12);
    }

    #[test]
    fn principal_axes_give_the_tensor_back() {
        let turn = DMat3::from_quat(DQuat::from_xyzw(0.1, -0.4, 0.3, 0.6).normalize());
        let tensor = turn * DMat3::from_diagonal(DVec3::new(3.0, 1.0, 2.0)) * turn.transpose();
        let (values, axes) = principal(tensor);
        let axes = DMat3::from_quat(axes);
        let back = axes * DMat3::from_diagonal(values) * axes.transpose();
        assert!((back - tensor).abs_diff_eq(DMat3::ZERO, 1e-12), "{back}");
        assert!((values.min_element() - 1.0).abs() < 1e-12, "{values}");
    }
}
