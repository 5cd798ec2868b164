//! Disc or ring that marks the gripper in a picture.

use std::ops::Range;

use glam::DVec3;

use crate::camera::PinholeCamera;
use crate::error::{InpaintingError, require_positive, require_that};

/// Disc or ring that is drawn over the gripper in a camera's pictures. Its size in the picture is
/// that at `reference_depth`, at any height of the gripper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripperMark {
    /// Outer radius of the mark (metres); 0 draws nothing.
    pub outer_radius: f64,
    /// Radius of the hole in the mark (metres): 0 for a filled disc, more for a ring.
    pub hole_radius: f64,
    /// RGB colour of the mark.
    pub color: [u8; 3],
    /// Distance from the camera (metres) at which the radii of the mark hold: that of the table.
    pub reference_depth: f64,
}

impl GripperMark {
    /// Returns a filled disc whose size in the picture is that of `outer_radius` at the distance
    /// `reference_depth` from the camera (metres).
    pub fn disc(outer_radius: f64, color: [u8; 3], reference_depth: f64) -> Self {
        Self { outer_radius, hole_radius: 0.0, color, reference_depth }
    }

    pub(crate) fn check(&self) -> Result<(), InpaintingError> {
        let drawn = self.outer_radius >= 0.0 && self.outer_radius.is_finite();
        let expected = "a length in metres, or 0 for no mark";
        require_that(drawn, "mark radius", &self.outer_radius, expected)?;
        let inside = (0.0..=self.outer_radius).contains(&self.hole_radius);
        let expected_hole = "a length in metres from 0 (a disc) to the mark's radius";
        require_that(inside, "mark hole", &self.hole_radius, expected_hole)?;
        require_positive("mark depth", self.reference_depth, "a positive length in metres")
    }

    /// Draws the mark over `rgb` `[height, width, 3]` at the projection of `point` (metres, world
    /// frame), or nothing if the point is behind the camera.
    pub(crate) fn draw(&self, camera: &PinholeCamera, point: DVec3, rgb: &mut [u8]) {
        let Some(offset) = camera.project(point) else {
            return;
        };
        let inside = &camera.intrinsics;
        let ring = Ring {
            centre: inside.principal_point,
            offset,
            radii: [self.outer_radius, self.hole_radius]
                .map(|radius| radius * inside.focal_lengths[0] / self.reference_depth),
            aspect: [1.0, inside.focal_lengths[0] / inside.focal_lengths[1]],
        };
        for row in ring.reach(1, inside.height) {
            for column in ring.reach(0, inside.width) {
                if ring.covers(column, row) {
                    rgb[(row * inside.width + column) * 3..][..3].copy_from_slice(&self.color);
                }
            }
        }
    }
}

/// Ring in a picture, in pixels, columns to the right and rows down.
struct Ring {
    /// Principal point of the camera.
    centre: [f64; 2],
    /// Offset of the ring's middle from the principal point. If the latter is the picture's middle,
    /// mirroring the offset mirrors the ring exactly.
    offset: [f64; 2],
    /// Outer and inner radius of the ring along rows.
    radii: [f64; 2],
    /// Ratio of the radius along rows to that along each axis: a disc shows as an ellipse if the
    /// two focal lengths differ.
    aspect: [f64; 2],
}

impl Ring {
    /// Returns the columns (axis 0) or rows (axis 1), of `count`, that the ring can cover.
    fn reach(&self, axis: usize, count: usize) -> Range<usize> {
        let middle = self.centre[axis] + self.offset[axis];
        let reach = self.radii[0] / self.aspect[axis] + 1.0;
        let pixel = |value: f64| value.clamp(0.0, count as f64) as usize;
        pixel(middle - reach)..pixel(middle + reach)
    }

    /// Returns `true` if the middle of a pixel lies between the inner and the outer radius of the
    /// ring.
    fn covers(&self, column: usize, row: usize) -> bool {
        let from_middle = |axis: usize, pixel: usize| {
            // in this order, or rounding would break the exact mirror symmetry
            (((pixel as f64 + 0.5) - self.centre[axis]) - self.offset[axis]) * self.aspect[axis]
        };
        let (dx, dy) = (from_middle(0, column), from_middle(1, row));
        let [outer, inner] = self.radii.map(|radius| radius * radius);
        (inner..outer).contains(&(dx * dx + dy * dy))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::camera::tests::askew;
    use crate::links::tests::point;

    pub const MARK: GripperMark = GripperMark {
        outer_radius: 0.1,
        hole_radius: 0.0,
        color: [0, 0, 255],
        reference_depth: 1.2,
    };

    /// The definition, pixel by pixel over the whole picture.
    fn slow_mark(mark: &GripperMark, camera: &PinholeCamera, point: DVec3) -> Vec<u8> {
        let ([cx, cy], [fx, fy]) =
            (camera.intrinsics.principal_point, camera.intrinsics.focal_lengths);
        let slopes = [mark.outer_radius, mark.hole_radius].map(|r| r / mark.reference_depth);
        let projected = camera.project(point);
        let pixel = |index: usize| {
            let inside = projected.is_some_and(|[right, down]| {
                let dx = (index % 40) as f64 + 0.5 - cx - right;
                let dy = (index / 40) as f64 + 0.5 - cy - down;
                (slopes[1]..slopes[0]).contains(&(dx / fx).hypot(dy / fy))
            });
            if inside { mark.color } else { [0; 3] }
        };
        (0..camera.num_pixels()).flat_map(pixel).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]

        #[test]
        fn a_mark_is_the_pixels_near_its_projection(
            point in point(),
            radius in 0.0..0.3,
            share in 0.0..1.0,
        ) {
            let (camera, hole) = (askew(), radius * share);
            let mark = GripperMark { outer_radius: radius, hole_radius: hole, ..MARK };
            let mut rgb = vec![0; 3 * camera.num_pixels()];
            mark.draw(&camera, point, &mut rgb);
            prop_assert_eq!(rgb, slow_mark(&mark, &camera, point));
        }
    }
}
