//! Scene in three dimensions: the objects on the table, the arm, and the camera above.

use envs::mujoco::GeomShape;
use envs::{Camera, TableTop, VisibleGeom};
use glam::{DMat3, DQuat, DVec3};
use re_sdk_types::archetypes::{
    Boxes3D, Capsules3D, Cylinders3D, Ellipsoids3D, Pinhole, Transform3D, ViewCoordinates,
};
use re_sdk_types::components::{Color, FillMode};
use re_sdk_types::datatypes::Quaternion;

use covers::RunError;

use crate::recording::Recording;

/// Recorder of the shapes on one table, with the pose at which each was recorded last.
pub(crate) struct ShapeRecorder {
    place: String,
    last: Vec<Option<(DVec3, DMat3)>>,
}

impl ShapeRecorder {
    /// Records the shapes of a table and the camera above it, and returns the recorder of their
    /// poses. Images of the camera are children of its path.
    pub fn record_shapes(
        place: String,
        table: &TableTop,
        above: &Camera,
        recording: &Recording,
    ) -> Result<Self, RunError> {
        recording.log_static(&place, &ViewCoordinates::RIGHT_HAND_Z_UP())?;
        let (pose, pinhole) = camera(above);
        let eye = format!("{place}/camera");
        recording.log_static(&eye, &pose)?;
        recording.log_static(&eye, &pinhole)?;
        let mut last = Vec::new();
        for (number, solid) in table.visible_geoms().enumerate() {
            shape(&path(&place, number, &solid), &solid, recording)?;
            last.push(None);
        }
        Ok(Self { place, last })
    }

    /// Records the poses of the shapes that have moved since the last call; the first call records
    /// all.
    pub fn record_moved_poses(
        &mut self,
        table: &TableTop,
        recording: &Recording,
    ) -> Result<(), RunError> {
        for (number, solid) in table.visible_geoms().enumerate() {
            let pose = Some((solid.position, solid.axes));
            // the viewer shows the latest pose, so poses that did not change are not repeated
            if self.last[number] != pose {
                let turn = DQuat::from_mat3(&solid.axes).as_quat().to_array();
                let transform = Transform3D::from_translation_rotation(
                    solid.position.as_vec3().to_array(),
                    Quaternion::from_xyzw(turn),
                );
                recording.log(&path(&self.place, number, &solid), &transform)?;
            }
            self.last[number] = pose;
        }
        Ok(())
    }
}

/// Returns the entity path of a shape in the recording.
fn path(place: &str, number: usize, solid: &VisibleGeom<'_>) -> String {
    let part = if solid.is_arm { "arm" } else { "table" };
    match solid.name {
        Some(name) => format!("{place}/{part}/{name}"),
        None => format!("{place}/{part}/{number}"),
    }
}

fn shape(place: &str, solid: &VisibleGeom<'_>, recording: &Recording) -> Result<(), RunError> {
    let [r, g, b, a] = solid.rgba.map(|part| (255.0 * part).round() as u8);
    let (colour, fill) = ([Color::from_unmultiplied_rgba(r, g, b, a)], FillMode::Solid);
    match solid.shape {
        GeomShape::Sphere { radius } => {
            let ball = Ellipsoids3D::from_radii([radius as f32]);
            recording.log_static(place, &ball.with_colors(colour).with_fill_mode(fill))
        }
        GeomShape::Capsule { radius, half_length } => {
            // a capsule of Rerun begins at the origin, and one of MuJoCo is centred there
            let begin = [0.0, 0.0, -half_length as f32];
            let capsule =
                Capsules3D::from_lengths_and_radii([2.0 * half_length as f32], [radius as f32]);
            let capsule = capsule.with_translations([begin]).with_colors(colour);
            recording.log_static(place, &capsule.with_fill_mode(fill))
        }
        GeomShape::Cylinder { radius, half_length } => {
            let cylinder =
                Cylinders3D::from_lengths_and_radii([2.0 * half_length as f32], [radius as f32]);
            recording.log_static(place, &cylinder.with_colors(colour).with_fill_mode(fill))
        }
        GeomShape::Box { half } => {
            let cuboid = Boxes3D::from_half_sizes([half.map(|side| side as f32)]);
            recording.log_static(place, &cuboid.with_colors(colour).with_fill_mode(fill))
        }
    }
}

/// Returns the pose and the projection of the camera.
fn camera(camera: &Camera) -> (Transform3D, Pinhole) {
    let turn = DQuat::from_mat3(&downwards()).as_quat().to_array();
    let above = [0.0, 0.0, camera.height as f32];
    let (focal, size) = (focal_length(camera) as f32, camera.size as f32);
    (
        Transform3D::from_translation_rotation(above, Quaternion::from_xyzw(turn)),
        Pinhole::from_focal_length_and_resolution([focal, focal], [size, size]),
    )
}

/// Returns the camera's axes in the world, as columns: x to the right of its image, y down in it, z
/// along the view. The camera looks down on the table's centre, and image up is +y.
fn downwards() -> DMat3 {
    DMat3::from_cols(DVec3::X, -DVec3::Y, -DVec3::Z)
}

/// Returns the focal length (pixels).
fn focal_length(camera: &Camera) -> f64 {
    camera.size as f64 * camera.height / (2.0 * camera.half_extent)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rerun's pinhole (x right, y down, z forward) projects points to the pixels of our camera.
    #[test]
    fn the_pinhole_projects_as_the_camera_does() {
        let camera = Camera { size: 144, ..Camera::default() };
        for point in [[0.1, 0.2, 0.0], [-0.4, 0.3, 0.15], [0.0, -0.2, 0.3]] {
            let point = DVec3::from_array(point);
            let eye = DVec3::new(0.0, 0.0, camera.height);
            let seen = downwards().transpose() * (point - eye);
            assert!(seen.z > 0.0, "{seen} is before the camera");
            let right = focal_length(&camera) * seen.x / seen.z;
            let down = focal_length(&camera) * seen.y / seen.z;
            let [u, v] = camera.project(point);
            assert!((right - u).abs() < 1e-9 && (down + v).abs() < 1e-9);
        }
    }
}
