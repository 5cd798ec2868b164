//! The capsule around a set of points.

use glam::{DQuat, DVec3};

use crate::capsule::{PlacedShape, Shape};
use crate::pose::Pose;

/// Smallest size of a shape (metres).
pub(crate) const LEAST_SIZE: f64 = 1e-6;

/// The smallest by volume of three capsules, along x, y and z, that hold all points. The axis of
/// each is in the middle of the points' extent.
pub(crate) fn around(points: &[DVec3]) -> PlacedShape {
    let along = DVec3::AXES.map(|axis| along(points, axis));
    let [x, y, z] = along;
    [y, z].into_iter().fold(x, |best, other| {
        if volume(&other) < volume(&best) {
            other
        } else {
            best
        }
    })
}

/// The shortest capsule of the least radius along `axis`.
fn along(points: &[DVec3], axis: DVec3) -> PlacedShape {
    let [low, high] = extent(points);
    let middle = 0.5 * (low + high) * (DVec3::ONE - axis);
    let across = |point: DVec3| (point - point.dot(axis) * axis).distance(middle);
    let radius = points
        .iter()
        .map(|&point| across(point))
        .fold(LEAST_SIZE, f64::max);
    // how far from the end of the segment a point may be, seen along the axis
    let reach = |point: DVec3| (radius * radius - across(point).powi(2)).max(0.0).sqrt();
    let ends = points.iter().map(|&point| {
        let (place, reach) = (point.dot(axis), reach(point));
        [place + reach, place - reach]
    });
    let [start, end] = ends.fold(
        [f64::INFINITY, f64::NEG_INFINITY],
        |[start, end], [s, e]| [start.min(s), end.max(e)],
    );
    let length = end - start;
    let shape = if length > LEAST_SIZE {
        Shape::Capsule { radius, length }
    } else {
        // the sphere may be anywhere from `end` to `start`
        Shape::Sphere {
            radius: radius + LEAST_SIZE,
        }
    };
    let pose = Pose {
        position: middle + 0.5 * (start + end) * axis,
        rotation: DQuat::from_rotation_arc(DVec3::Z, axis),
    };
    PlacedShape { pose, shape }
}

fn extent(points: &[DVec3]) -> [DVec3; 2] {
    let first = [DVec3::INFINITY, DVec3::NEG_INFINITY];
    points.iter().fold(first, |[low, high], &point| {
        [low.min(point), high.max(point)]
    })
}

/// In units of pi.
fn volume(placed: &PlacedShape) -> f64 {
    match placed.shape {
        Shape::Capsule { radius, length } => radius * radius * (length + 4.0 / 3.0 * radius),
        Shape::Sphere { radius } => 4.0 / 3.0 * radius.powi(3),
        Shape::Cylinder { .. } | Shape::Box { .. } => f64::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        /// All points are inside, and one at least is on the surface.
        #[test]
        fn the_capsule_holds_all_points_and_is_no_larger_than_it_must(
            points in prop::collection::vec(prop::array::uniform3(-1.0..1.0), 1..20),
            stretch in prop::array::uniform3(0.01..2.0),
        ) {
            let stretch = DVec3::from_array(stretch);
            let points: Vec<DVec3> =
                points.into_iter().map(|point| stretch * DVec3::from_array(point)).collect();
            let capsule = around(&points).capsule(&Pose::IDENTITY);
            let outside = points.iter().map(|&point| capsule.distance(point));
            let furthest = outside.fold(f64::NEG_INFINITY, f64::max);
            prop_assert!(furthest.abs() < 2.1 * LEAST_SIZE, "{furthest}");
        }
    }

    #[test]
    fn a_long_thing_has_a_long_capsule() {
        let corner = |x: f64| [DVec3::new(x, 0.1, 0.0), DVec3::new(x, -0.1, 0.0)];
        let points = [corner(-1.0), corner(3.0)].concat();
        let capsule = around(&points).capsule(&Pose::IDENTITY);
        assert!((capsule.radius - 0.1).abs() < 1e-12, "{capsule:?}");
        assert!(
            capsule.ends[0].distance(DVec3::new(-1.0, 0.0, 0.0)) < 1e-12,
            "{capsule:?}"
        );
        assert!(
            capsule.ends[1].distance(DVec3::new(3.0, 0.0, 0.0)) < 1e-12,
            "{capsule:?}"
        );
    }
}
