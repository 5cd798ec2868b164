//! Convex hulls of the points of meshes, and capsules around them.

use std::f64::consts::PI;
use std::sync::Arc;

use glam::DVec3;

use crate::capsule::{Capsule, ConvexHull, PlacedShape, Shape, furthest};
use crate::fit::{bounding_capsule, extent, volume};
use crate::pose::Pose;

/// Number of directions in which the outermost points are kept. The hull of those is up to 2 % of
/// the radius too small where a mesh is round; shallow tips between the directions are lost.
const DIRECTIONS: usize = 200;
/// Largest number of capsules around a hull.
const MAX_CAPSULES: usize = 4;
/// Smallest thickness of a hull (metres). MuJoCo rejects flat ones, and rounds to single precision.
const MIN_THICKNESS: f64 = 2e-3;

/// Returns the convex hull of the points of a mesh, or a capsule if the mesh is flat. `points` must
/// not be empty.
pub(crate) fn mesh_shape(points: &[DVec3]) -> PlacedShape {
    let [low, high] = extent(points);
    let pose = Pose::from_position(low.midpoint(high));
    let centred: Vec<DVec3> = points.iter().map(|&point| point - pose.position).collect();
    let single = bounding_capsule(&centred);
    let Some(corners) = tetrahedron(&centred) else {
        return PlacedShape { pose: pose * single.pose, ..single };
    };
    let mut outermost = corners.to_vec();
    for direction in directions() {
        let point = furthest(&centred, |point| point.dot(direction));
        if !outermost.contains(&point) {
            outermost.push(point);
        }
    }
    let sliced = (2..=MAX_CAPSULES).map(|count| slice_capsules(&outermost, &centred, count));
    let size = |capsules: &[PlacedShape]| capsules.iter().map(volume).sum::<f64>();
    let capsules =
        sliced.fold(
            vec![single],
            |best, capsules| {
                if size(&capsules) < size(&best) { capsules } else { best }
            },
        );
    PlacedShape { pose, shape: Shape::Hull(Arc::new(ConvexHull::new(outermost, capsules))) }
}

/// Returns capsules around slices of a hull across its longest side, which enclose `all` points,
/// too.
fn slice_capsules(hull: &[DVec3], all: &[DVec3], count: usize) -> Vec<PlacedShape> {
    let [low, high] = extent(hull);
    let axis = (high - low).max_position();
    let plane = |number: usize| low[axis] + (high - low)[axis] * number as f64 / count as f64;
    let slice = |number: usize| {
        let [start, end] = [plane(number), plane(number + 1)];
        let mut points = hull.to_vec();
        points.retain(|point| (start..=end).contains(&point[axis]));
        for side in [start, end] {
            let below = hull.iter().filter(|point| point[axis] < side);
            let above = || hull.iter().filter(|point| point[axis] > side);
            points.extend(below.flat_map(|&from| {
                above().map(move |&to| from.lerp(to, (side - from[axis]) / (to[axis] - from[axis])))
            }));
        }
        bounding_capsule(&points)
    };
    let mut capsules: Vec<PlacedShape> = (0..count).map(slice).collect();
    let solids: Vec<Capsule> =
        capsules.iter().flat_map(|of| of.enclosing_capsules(&Pose::IDENTITY)).collect();
    let outside = all.iter().map(|&point| {
        let distances = solids.iter().map(|solid| solid.signed_distance_to_point(point));
        distances.fold(f64::INFINITY, f64::min)
    });
    let missing = outside.fold(0.0, f64::max);
    for capsule in &mut capsules {
        if let Shape::Sphere { radius } | Shape::Capsule { radius, .. } = &mut capsule.shape {
            *radius += missing;
        }
    }
    capsules
}

/// Returns four points that span much of the volume of all points; `None` if it is flat.
fn tetrahedron(points: &[DVec3]) -> Option<[DVec3; 4]> {
    let a = furthest(points, |point| point.length_squared());
    let b = furthest(points, |point| point.distance_squared(a));
    let along = (b - a).try_normalize()?;
    let c = furthest(points, |point| (point - a).reject_from(along).length_squared());
    let across = (c - a).reject_from(along).try_normalize()?;
    let normal = along.cross(across);
    let height = |point: DVec3| (point - a).dot(normal).abs();
    let d = furthest(points, height);
    let thickness = height(d).min((c - a).dot(across));
    (thickness >= MIN_THICKNESS).then_some([a, b, c, d])
}

/// Returns unit vectors that are spread evenly: Fibonacci's lattice on the sphere.
fn directions() -> impl Iterator<Item = DVec3> {
    let golden_angle = PI * (3.0 - 5.0_f64.sqrt());
    (0..DIRECTIONS).map(move |index| {
        let z = 1.0 - (2 * index + 1) as f64 / DIRECTIONS as f64;
        let (sin, cos) = (golden_angle * index as f64).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        DVec3::new(radius * cos, radius * sin, z)
    })
}

#[cfg(test)]
mod tests {
    use glam::DQuat;
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn a_hull_and_its_capsules_hold_the_points(
            points in prop::collection::vec(prop::array::uniform3(-1.0..1.0), 20..2000),
            stretch in prop::array::uniform3(0.1..2.0),
            direction in prop::array::uniform3(-1.0..1.0),
        ) {
            let stretch = DVec3::from_array(stretch);
            let points: Vec<DVec3> = points
                .into_iter()
                .map(|point| DVec3::from_array(point) * stretch + DVec3::X)
                .collect();
            let placed = mesh_shape(&points);
            let Shape::Hull(hull) = &placed.shape else {
                return Err(TestCaseError::fail("no hull"));
            };
            let direction = DVec3::from_array(direction).normalize_or(DVec3::Y);
            let ends = furthest(&points, |point| point.dot(direction)).dot(direction);
            let own = (placed.pose.position + hull.support(direction)).dot(direction);
            let missing = ends - own;
            prop_assert!((-1e-12..0.4 * stretch.length()).contains(&missing), "{missing}");
            prop_assert!(hull.points().len() <= DIRECTIONS + 4);
            let capsules = placed.enclosing_capsules(&Pose::IDENTITY);
            let between = hull.points().windows(2).flat_map(|pair| {
                [0.3, 0.5].map(|part| placed.pose.position + pair[0].lerp(pair[1], part))
            });
            for point in points.iter().copied().chain(between) {
                let outside = capsules.iter().map(|of| of.signed_distance_to_point(point));
                prop_assert!(outside.fold(f64::INFINITY, f64::min) < 1e-9);
            }
        }
    }

    #[test]
    fn a_round_hull_is_2_percent_too_small_at_most() {
        let turns = (0..100).map(|index| DQuat::from_rotation_z(f64::from(index) * 0.0371));
        let points: Vec<DVec3> =
            turns.flat_map(|turn| directions().map(move |way| turn * way)).collect();
        let Shape::Hull(hull) = mesh_shape(&points).shape else {
            panic!("no hull");
        };
        for way in &points {
            assert!(hull.support(*way).dot(*way) > 0.98, "{way}");
        }
    }

    /// A bar that is thick at one end alone.
    #[test]
    fn several_capsules_are_tighter_than_one() {
        let ring = |x: f64, radius: f64| {
            (0..30).map(move |index| {
                let angle = f64::from(index) * PI / 15.0;
                DVec3::new(x, radius * angle.cos(), radius * angle.sin())
            })
        };
        let points: Vec<DVec3> = ring(0.0, 0.1).chain(ring(0.5, 0.02)).collect();
        let placed = mesh_shape(&points);
        let capsules = placed.enclosing_capsules(&Pose::IDENTITY);
        assert!((2..=MAX_CAPSULES).contains(&capsules.len()), "{capsules:?}");
        let far = DVec3::new(0.45, 0.08, 0.0);
        assert!(capsules.iter().all(|of| of.signed_distance_to_point(far) > 0.0), "{capsules:?}");
        let single = bounding_capsule(&points).enclosing_capsules(&Pose::IDENTITY);
        assert!(single[0].signed_distance_to_point(far) < 0.0);
    }

    #[test]
    fn flat_meshes_are_capsules() {
        let corner = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
        let plate = |thick: f64| {
            [[0.0, 0.0], [0.1, 0.0], [0.1, 0.2], [0.0, 0.2]]
                .map(|[x, y]| [corner(x, y, 1.0), corner(x, y, 1.0 + thick)])
                .concat()
        };
        for (points, is_hull) in [
            (plate(3e-3), true),
            (plate(1e-3), false),
            (plate(0.0), false),
            (vec![corner(1.0, 2.0, 3.0)], false),
            (vec![corner(1.0, 2.0, 3.0), corner(1.0, 2.0, 4.0), corner(1.0, 2.0, 5.0)], false),
        ] {
            let placed = mesh_shape(&points);
            assert_eq!(matches!(placed.shape, Shape::Hull(_)), is_hull, "{placed:?}");
            let capsules = placed.enclosing_capsules(&Pose::IDENTITY);
            let holds = |&point: &DVec3| {
                capsules.iter().any(|of| of.signed_distance_to_point(point) < 1e-5)
            };
            assert!(points.iter().all(holds), "{placed:?}");
        }
    }
}
