//! The top-down camera: where it is, how points project, and the disc that marks the gripper.

use glam::DVec3;

use crate::EnvError;

/// Largest picture that is drawn (pixels along a side).
const LARGEST: usize = 4096;
/// Lowest camera (metres); at or below the hand's height a projection would be mirrored.
const LOWEST: f64 = 0.6;

/// A square pinhole camera straight over the table's centre; image up is +y, image right is +x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Pixels along either side; even, so that flips map pixels to pixels.
    pub size: usize,
    /// Height over the table (metres).
    pub height: f64,
    /// Half the side of the square seen on the table (metres).
    pub half_extent: f64,
    /// Radius on the table of the disc that marks the gripper (metres); zero draws none.
    pub disc_radius: f64,
    /// Colour of that disc, RGB.
    pub disc_color: [u8; 3],
}

impl Default for Camera {
    fn default() -> Self {
        Self {
            size: 48,
            height: 1.5,
            half_extent: 0.44,
            disc_radius: 0.03,
            disc_color: [0, 0, 255],
        }
    }
}

impl Camera {
    /// Refuses sizes that a flip does not map onto themselves and cameras that see nothing.
    pub(crate) fn check(&self) -> Result<(), EnvError> {
        let setting = |name, value: String, expected| EnvError::Setting {
            name,
            value,
            expected,
        };
        if !(2..=LARGEST).contains(&self.size) || !self.size.is_multiple_of(2) {
            let expected =
                "an even number of pixels in 2..=4096, so that the centre lies between pixels";
            return Err(setting("image size", self.size.to_string(), expected));
        }
        if !(self.height >= LOWEST && self.height.is_finite()) {
            let expected = "at least 0.6 m, above everything that the hand can reach";
            return Err(setting("camera height", self.height.to_string(), expected));
        }
        if !(self.half_extent > 0.0 && self.half_extent.is_finite()) {
            let value = self.half_extent.to_string();
            return Err(setting(
                "camera half extent",
                value,
                "a positive length in metres",
            ));
        }
        if !(self.disc_radius >= 0.0 && self.disc_radius.is_finite()) {
            let value = self.disc_radius.to_string();
            return Err(setting(
                "disc radius",
                value,
                "a length in metres, or 0 for no disc",
            ));
        }
        Ok(())
    }

    /// The camera as an MJCF element.
    pub(crate) fn to_mjcf(self, name: &str) -> String {
        let fovy = 2.0 * (self.half_extent / self.height).atan().to_degrees();
        let height = self.height;
        format!("<camera name=\"{name}\" pos=\"0 0 {height}\" quat=\"1 0 0 0\" fovy=\"{fovy}\"/>")
    }

    /// Projects a world point (metres) to the image: pixels right of and above the image's centre.
    ///
    /// Mirroring the point negates the result exactly.
    pub fn project(&self, point: DVec3) -> [f64; 2] {
        let scale = self.pixels_per_metre() * self.height / (self.height - point.z);
        [point.x * scale, point.y * scale]
    }

    fn pixels_per_metre(&self) -> f64 {
        self.size as f64 / (2.0 * self.half_extent)
    }

    /// Draws a disc of this camera's `disc_radius` over `rgb` `[size, size, 3]`, centred on the projection of `point` (metres).
    pub fn draw_disc(&self, point: DVec3, color: [u8; 3], rgb: &mut [u8]) {
        let [u, v] = self.project(point);
        let radius = self.disc_radius * self.pixels_per_metre();
        let middle = self.size as f64 / 2.0;
        for (row, line) in rgb.chunks_exact_mut(3 * self.size).enumerate() {
            let dy = (middle - (row as f64 + 0.5)) - v;
            for (col, pixel) in line.chunks_exact_mut(3).enumerate() {
                let dx = ((col as f64 + 0.5) - middle) - u;
                if dx * dx + dy * dy < radius * radius {
                    pixel.copy_from_slice(&color);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use symmetry::D2;

    #[test]
    fn odd_sizes_and_blind_cameras_are_refused() {
        let odd = Camera {
            size: 47,
            ..Camera::default()
        };
        assert!(odd.check().unwrap_err().to_string().contains("47"));
        let blind = Camera {
            half_extent: 0.0,
            ..Camera::default()
        };
        assert!(blind.check().is_err());
        let low = Camera {
            height: 0.2,
            ..Camera::default()
        };
        assert!(low.check().unwrap_err().to_string().contains("0.2"));
        let huge = Camera {
            size: 1 << 40,
            ..Camera::default()
        };
        assert!(huge.check().is_err());
    }

    #[test]
    fn the_disc_of_a_mirrored_point_is_the_mirrored_disc() {
        let camera = Camera::default();
        let draw = |p: DVec3| {
            let mut rgb = vec![0; camera.size * camera.size * 3];
            camera.draw_disc(p, camera.disc_color, &mut rgb);
            rgb
        };
        let point = DVec3::new(0.137, 0.083, 0.2);
        let picture = draw(point);
        assert!(picture.contains(&255));
        for g in D2::ALL {
            let [x, y] = g.apply_xy([point.x, point.y]);
            let mirrored = g.transform_image(&picture, camera.size, camera.size, 3);
            assert_eq!(draw(DVec3::new(x, y, point.z)), mirrored, "{g}");
        }
    }

    #[test]
    fn row_zero_is_far_and_column_zero_is_left() {
        let camera = Camera::default();
        let mut rgb = vec![0; camera.size * camera.size * 3];
        camera.draw_disc(DVec3::new(-0.4, 0.4, 0.0), camera.disc_color, &mut rgb);
        let first = rgb.iter().position(|&v| v == 255).unwrap() / 3;
        assert!(first / camera.size < 4 && first % camera.size < 4);
    }
}
