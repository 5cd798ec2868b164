//! The disc or ring that is drawn where the gripper is.

use crate::camera::{Intrinsics, PinholeCamera};
use crate::error::{InpaintingError, require};
use glam::DVec3;

/// A disc or a ring that is drawn over the gripper, as large in the picture as one that lies at
/// `depth`, however high the gripper is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// Outer radius (metres); zero draws nothing.
    pub radius: f64,
    /// Radius of the hole (metres); zero is a filled disc, more a ring.
    pub hole: f64,
    /// Colour, RGB.
    pub color: [u8; 3],
    /// Distance from the camera at which the mark has its size (metres): that of the table.
    pub depth: f64,
}

impl Mark {
    pub(crate) fn check(&self) -> Result<(), InpaintingError> {
        let drawn = self.radius >= 0.0 && self.radius.is_finite();
        let expected = "a length in metres, or 0 for no mark";
        require(drawn, "mark radius", &self.radius, expected)?;
        let inside = (0.0..=self.radius).contains(&self.hole);
        let expected = "a length in metres from 0 (a disc) to the mark's radius";
        require(inside, "mark hole", &self.hole, expected)?;
        let ahead = self.depth > 0.0 && self.depth.is_finite();
        let expected = "a positive length in metres";
        require(ahead, "mark depth", &self.depth, expected)
    }

    /// Draws the mark over `rgb` `[H, W, 3]` where `camera` sees `point` (metres, world frame);
    /// nothing where the point is behind the camera.
    pub(crate) fn draw(&self, camera: &PinholeCamera, point: DVec3, rgb: &mut [u8]) {
        let Intrinsics { focal, .. } = camera.intrinsics;
        if let Some(offset) = camera.project(point) {
            let radii = [self.radius, self.hole].map(|radius| radius * focal[0] / self.depth);
            draw_ring(&camera.intrinsics, offset, radii, self.color, rgb);
        }
    }
}

/// Colours the pixels of `rgb` `[H, W, 3]` whose middles are nearer than `radii[0]` and not nearer
/// than `radii[1]` to the point `offset` (right, down) from the optical axis; all in pixels.
/// Mirroring the offset mirrors the ring exactly where the axis goes through the picture's middle.
fn draw_ring(
    intrinsics: &Intrinsics,
    offset: [f64; 2],
    radii: [f64; 2],
    color: [u8; 3],
    rgb: &mut [u8],
) {
    let Intrinsics {
        width,
        height,
        centre,
        ..
    } = *intrinsics;
    // pixels outside of these ranges cannot be reached
    let reach = |axis: usize, count: usize| {
        let middle = centre[axis] + offset[axis];
        let [low, high] = [-1.0, 1.0].map(|side| middle + side * (radii[0] + 1.0));
        let pixel = |value: f64| value.clamp(0.0, count as f64) as usize;
        pixel(low)..pixel(high)
    };
    let squares = radii.map(|radius| radius * radius);
    let columns = reach(0, width);
    for row in reach(1, height) {
        let dy = ((row as f64 + 0.5) - centre[1]) - offset[1];
        for column in columns.clone() {
            let dx = ((column as f64 + 0.5) - centre[0]) - offset[0];
            let distance = dx * dx + dy * dy;
            if distance < squares[0] && distance >= squares[1] {
                rgb[(row * width + column) * 3..][..3].copy_from_slice(&color);
            }
        }
    }
}
