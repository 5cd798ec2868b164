//! Bounding capsule of a set of points.

use glam::{DQuat, DVec3};

use crate::capsule::{PlacedShape, Shape};
use crate::pose::Pose;

/// Smallest size of a shape (metres): MuJoCo needs positive sizes.
pub(crate) const MIN_SHAPE_SIZE: f64 = 1e-6;

/// Returns the smallest by volume of three capsules, along x, y and z, that enclose all points.
///
/// The axis of each passes through the middle of the points' bounding box.
pub(crate) fn bounding_capsule(points: &[DVec3]) -> PlacedShape {
    let [x, y, z] = DVec3::AXES.map(|axis| capsule_along(points, axis));
    [y, z].into_iter().fold(
        x,
        |best, other| {
            if volume(&other) < volume(&best) { other } else { best }
        },
    )
}

fn capsule_along(points: &[DVec3], axis: DVec3) -> PlacedShape {
    let [low, high] = extent(points);
    let middle = 0.5 * (low + high) * (DVec3::ONE - axis);
    // positions along the axis, and distances from it
    let points = points.iter().map(|&point| {
        let position = point.dot(axis);
        (position, (point - position * axis).distance(middle))
    });
    let radius = points.clone().map(|(_, across)| across);
    let radius = radius.fold(MIN_SHAPE_SIZE, f64::max);
    let [start, end] = segment(points, radius);
    let pose = Pose {
        position: middle + 0.5 * (start + end) * axis,
        rotation: DQuat::from_rotation_arc(DVec3::Z, axis),
    };
    let shape = shape(radius, end - start);
    PlacedShape { pose, shape }
}

/// Returns the start and end of the shortest segment that has no point farther away than `radius`.
/// `points` are positions along the axis, and distances from it.
fn segment(points: impl Iterator<Item = (f64, f64)>, radius: f64) -> [f64; 2] {
    let ends = points.map(|(position, across)| {
        // a hemisphere reaches this far beyond its centre at the distance `across`
        let reach = (radius * radius - across.powi(2)).max(0.0).sqrt();
        [position + reach, position - reach]
    });
    let none = [f64::INFINITY, f64::NEG_INFINITY];
    ends.fold(none, |[start, end], [s, e]| [start.min(s), end.max(e)])
}

/// Returns a capsule, or a sphere if the segment has no length.
fn shape(radius: f64, length: f64) -> Shape {
    if length > MIN_SHAPE_SIZE {
        return Shape::Capsule { radius, length };
    }
    // MIN_SHAPE_SIZE more, so that it covers a segment of up to that length
    let radius = radius + MIN_SHAPE_SIZE;
    Shape::Sphere { radius }
}

/// Returns the lowest and the highest corner of the bounding box of points.
pub(crate) fn extent(points: &[DVec3]) -> [DVec3; 2] {
    let first = [DVec3::INFINITY, DVec3::NEG_INFINITY];
    points.iter().fold(first, |[low, high], &point| [low.min(point), high.max(point)])
}

/// Returns the volume of a capsule or sphere, divided by pi; infinite for other shapes.
pub(crate) fn volume(placed: &PlacedShape) -> f64 {
    match placed.shape {
        Shape::Capsule { radius, length } => radius * radius * (length + 4.0 / 3.0 * radius),
        Shape::Sphere { radius } => 4.0 / 3.0 * radius.powi(3),
        Shape::Cylinder { .. } | Shape::Box { .. } | Shape::Hull(_) => f64::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        /// All points are inside, and at least one is on the surface.
        #[test]
        fn the_capsule_holds_all_points_and_is_no_larger_than_it_must(
            points in prop::collection::vec(prop::array::uniform3(-1.0..1.0), 1..20),
            stretch in prop::array::uniform3(0.01..2.0),
        ) {
            let stretch = DVec3::from_array(stretch);
            let points: Vec<DVec3> =
                points.into_iter().map(|point| stretch * DVec3::from_array(point)).collect();
            let capsule = bounding_capsule(&points).enclosing_capsules(&Pose::IDENTITY)[0];
            let outside = points.iter().map(|&point| capsule.signed_distance_to_point(point));
            let furthest = outside.fold(f64::NEG_INFINITY, f64::max);
            prop_assert!(furthest.abs() < 2.1 * MIN_SHAPE_SIZE, "{furthest}");
        }
    }

    #[test]
    fn a_long_thing_has_a_long_capsule() {
        let corner = |x: f64| [DVec3::new(x, 0.1, 0.0), DVec3::new(x, -0.1, 0.0)];
        let points = [corner(-1.0), corner(3.0)].concat();
        let capsule = bounding_capsule(&points).enclosing_capsules(&Pose::IDENTITY)[0];
        assert!((capsule.radius - 0.1).abs() < 1e-12, "{capsule:?}");
        assert!(capsule.ends[0].distance(DVec3::new(-1.0, 0.0, 0.0)) < 1e-12, "{capsule:?}");
        assert!(capsule.ends[1].distance(DVec3::new(3.0, 0.0, 0.0)) < 1e-12, "{capsule:?}");
    }
}
