//! Homography between the pictures of a camera with an error in its pose and of the nominal camera.

use glam::{DMat3, DQuat, DVec3};

use crate::camera::Camera;

/// Homography from the picture of a misplaced camera to that of the nominal camera, for points in
/// the plane of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Homography {
    /// Matrix rows that map a pixel offset (right, up, 1) to a point in homogeneous coordinates.
    rows: [[f32; 3]; 3],
    /// Translation that is added to the mapped point (pixels).
    shift: [f32; 2],
}

impl Homography {
    /// Homography of a camera in its nominal pose.
    pub const IDENTITY: Self =
        Self { rows: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], shift: [0.0; 2] };

    /// Creates the homography of `camera` moved by `position` (metres), then rotated by the length
    /// of `turn` (radians) about its direction.
    ///
    /// The camera's pixel (u, v) looks along R (u, v, -f), from a height larger by `position.z`.
    /// [`Homography::map_offset_to_nominal`] returns the nominal camera's pixel for the point where
    /// that ray meets the table.
    pub fn new(camera: &Camera, position: DVec3, turn: DVec3) -> Self {
        // the table is `height` away, so a metre on it is as long as one in the focal plane
        let focal = camera.millimetres_to_pixels(1e3 * camera.height);
        let rotation = DMat3::from_quat(DQuat::from_scaled_axis(turn));
        let higher = 1.0 + position.z / camera.height;
        let across = |axis| {
            let row = higher * rotation.row(axis);
            [row.x, row.y, -focal * row.z]
        };
        let row = rotation.row(2);
        let down = [-row.x / focal, -row.y / focal, row.z];
        Self {
            rows: [across(0), across(1), down].map(|numbers| numbers.map(|number| number as f32)),
            shift: [position.x, position.y]
                .map(|metres| camera.millimetres_to_pixels(1e3 * metres) as f32),
        }
    }

    /// Returns the offset (right, up) in the nominal picture of the point that the misplaced camera
    /// shows at the offset (u, v); both from the picture's centre, in pixels.
    pub fn map_offset_to_nominal(&self, [u, v]: [f32; 2]) -> [f32; 2] {
        let [x, y, divisor] = self.rows.map(|[a, b, c]| a * u + b * v + c);
        // one division for both coordinates of every pixel
        let scale = 1.0 / divisor;
        [self.shift[0] + x * scale, self.shift[1] + y * scale]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Projects a point of the table into the picture of `camera`, moved and turned, without the
    /// homography.
    fn projected(camera: &Camera, position: DVec3, turn: DVec3, point: DVec3) -> [f64; 2] {
        let rotation = DMat3::from_quat(DQuat::from_scaled_axis(turn));
        let eye = position + camera.height * DVec3::Z;
        let ray = rotation.transpose() * (point - eye);
        let focal = camera.millimetres_to_pixels(1e3 * camera.height);
        [ray.x, ray.y].map(|across| -focal * across / ray.z)
    }

    #[test]
    fn a_view_is_the_projection_read_backwards() {
        let camera = Camera::default();
        let position = DVec3::new(0.02, -0.01, 0.03);
        let turn = DVec3::new(0.01, 0.02, -0.05);
        let view = Homography::new(&camera, position, turn);
        for point in [[0.0, 0.0], [0.3, -0.2], [-0.4, 0.35]] {
            let point = DVec3::new(point[0], point[1], 0.0);
            let seen = projected(&camera, position, turn, point);
            let place = view.map_offset_to_nominal(seen.map(|offset| offset as f32));
            let right = camera.project(point);
            for axis in 0..2 {
                let off = (f64::from(place[axis]) - right[axis]).abs();
                assert!(off < 1e-4, "{place:?} {right:?}");
            }
        }
    }

    #[test]
    fn without_an_error_every_place_is_itself_to_the_bit() {
        let view = Homography::new(&Camera::default(), DVec3::ZERO, DVec3::ZERO);
        assert_eq!(view, Homography::IDENTITY);
        for offset in [[0.5, -23.5], [-7.5, 11.5]] {
            assert_eq!(view.map_offset_to_nominal(offset), offset);
        }
    }

    /// Half a degree, 1.5 m high: the middle shows what is 13 mm beside.
    #[test]
    fn a_tilt_moves_the_picture_and_a_height_scales_it() {
        let camera = Camera::default();
        let tilt = Homography::new(&camera, DVec3::ZERO, 0.5_f64.to_radians() * DVec3::Y);
        let [x, y] = tilt.map_offset_to_nominal([0.0; 2]);
        let moved = camera.millimetres_to_pixels(1500.0 * 0.5_f64.to_radians().tan()) as f32;
        assert!((x + moved).abs() < 1e-4 && y == 0.0, "{x} {y} {moved}");
        let high = Homography::new(&camera, 0.15 * DVec3::Z, DVec3::ZERO);
        let [high_x, high_y] = high.map_offset_to_nominal([10.0, -20.0]);
        assert!((high_x - 11.0).abs() < 1e-4 && (high_y + 22.0).abs() < 1e-4, "{high_x} {high_y}");
    }
}
