//! Mask of an arm in a picture: capsules between its joints, seen by the camera.

use std::ops::Range;

use glam::DVec3;

use crate::camera::PinholeCamera;

/// Link of an arm: all points within `radius` of the segment between two joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmLink {
    /// Indices of the joints at both ends of the link.
    pub end_joints: [usize; 2],
    /// Radius of the link's capsule (metres).
    pub radius: f64,
}

/// Link of an arm in the camera's frame (metres).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Capsule {
    pub ends: [DVec3; 2],
    pub radius: f64,
}

impl Capsule {
    /// Marks the pixels of `mask` `[height, width]` whose viewing ray meets the capsule.
    pub(crate) fn add_to_mask(&self, camera: &PinholeCamera, mask: &mut [bool]) {
        let [rows, columns] = self.window(camera);
        for row in rows {
            for column in columns.clone() {
                if self.intersects_ray(camera.pixel_ray(row, column)) {
                    mask[row * camera.intrinsics.width + column] = true;
                }
            }
        }
    }

    /// Returns `true` if the ray from the camera along the unit vector `ray` meets the capsule in
    /// front of the camera.
    pub(crate) fn intersects_ray(&self, ray: DVec3) -> bool {
        let [from, to] = self.ends;
        let axis = to - from;
        // the point of the axis next to the ray's line: both squared distances are convex, so
        // clamping is exact
        let (along, across) = (axis.dot(ray), axis.cross(ray).length_squared());
        let share = if across > 0.0 {
            ((along * from.dot(ray) - axis.dot(from)) / across).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let nearest = from + share * axis;
        let depth = nearest.dot(ray);
        depth > 0.0 && nearest.distance_squared(depth * ray) <= self.radius * self.radius
    }

    /// Returns the range of rows and that of columns outside of which no viewing ray meets the
    /// capsule.
    fn window(&self, camera: &PinholeCamera) -> [Range<usize>; 2] {
        let intrinsics = &camera.intrinsics;
        let whole = [0..intrinsics.height, 0..intrinsics.width];
        let low = self.ends[0].min(self.ends[1]) - self.radius;
        let high = self.ends[0].max(self.ends[1]) + self.radius;
        // the bounds below need a box that lies in front of the camera
        if low.z <= 0.0 {
            return whole;
        }
        let side = |axis: usize, focal: f64, centre: f64, count: usize| {
            // a box around the capsule looks largest from its near or its far face
            let faces = [low.z, high.z].map(|z| [low[axis] / z, high[axis] / z]);
            // a pixel more on each side, for rounding
            let first = faces[0][0].min(faces[1][0]) * focal + centre - 1.0;
            let last = faces[0][1].max(faces[1][1]) * focal + centre + 1.0;
            let pixel = |value: f64| value.clamp(0.0, count as f64) as usize;
            pixel(first)..pixel(last)
        };
        let ([fx, fy], [cx, cy]) = (intrinsics.focal_lengths, intrinsics.principal_point);
        [side(1, fy, cy, intrinsics.height), side(0, fx, cx, intrinsics.width)]
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::camera::tests::askew;

    /// Returns `true` if the ray meets one of many spheres along the capsule's axis.
    fn slow_meets(capsule: &Capsule, ray: DVec3, slack: f64) -> bool {
        let [from, to] = capsule.ends;
        (0..=400).any(|i| {
            let centre = from.lerp(to, f64::from(i) / 400.0);
            let depth = centre.dot(ray);
            depth > 0.0 && centre.distance(depth * ray) <= capsule.radius + slack
        })
    }

    pub fn point() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-0.6..0.6).prop_map(DVec3::from_array)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]

        #[test]
        fn masks_are_the_rays_that_meet_a_chain_of_spheres(from in point(), to in point()) {
            let camera = askew();
            let ends = [from, to].map(|point| camera.world_to_camera(point));
            let capsule = Capsule { ends, radius: 0.08 };
            let mut mask = vec![false; camera.num_pixels()];
            capsule.add_to_mask(&camera, &mut mask);
            for (index, &hidden) in mask.iter().enumerate() {
                let ray = camera.pixel_ray(index / 40, index % 40);
                // the chain is a little thinner between its spheres
                prop_assert!(hidden || !slow_meets(&capsule, ray, 0.0), "{index}");
                prop_assert!(!hidden || slow_meets(&capsule, ray, 1e-3), "{index}");
            }
        }
    }
}
