//! Links whose collision shapes touch: the test of Gilbert, Johnson and Keerthi (1988, "A fast
//! procedure for computing the distance between complex objects in three-dimensional space").

use glam::{DMat3, DVec3};

use crate::capsule::{PlacedShape, Shape};
use crate::pose::Pose;

/// Shapes that are nearer than this (metres) touch: a simulated arm sags by as much.
const CLEARANCE: f64 = 1e-3;
/// Most steps of the search. Shapes that it leaves undecided are at the clearance, but for
/// rounding.
const STEPS: usize = 100;

/// A convex shape in the world: all points within `radius` of a box, a cylinder, a segment or a
/// point.
#[derive(Clone, Copy)]
struct Solid {
    shape: Shape,
    pose: Pose,
    radius: f64,
}

impl Solid {
    fn new(placed: &PlacedShape, link: &Pose) -> Self {
        let radius = match placed.shape {
            Shape::Sphere { radius } | Shape::Capsule { radius, .. } => radius,
            Shape::Cylinder { .. } | Shape::Box { .. } => 0.0,
        };
        Self {
            shape: placed.shape,
            pose: *link * placed.pose,
            radius,
        }
    }

    /// The point that lies furthest in a direction, but for its radius.
    fn furthest(&self, direction: DVec3) -> DVec3 {
        let direction = self.pose.rotation.conjugate() * direction;
        let at_end = |length: f64| (0.5 * length).copysign(direction.z) * DVec3::Z;
        let point = match self.shape {
            Shape::Sphere { .. } => DVec3::ZERO,
            Shape::Capsule { length, .. } => at_end(length),
            Shape::Cylinder { radius, length } => {
                let across = direction.with_z(0.0).normalize_or_zero();
                radius * across + at_end(length)
            }
            Shape::Box { half } => half.copysign(direction),
        };
        self.pose.point(point)
    }

    fn touches(&self, other: &Self) -> bool {
        let limit = self.radius + other.radius + CLEARANCE;
        // differences of a point of one solid and a point of the other: the nearest one to zero so
        // far, and those that it lies between
        let mut nearest = self.pose.position - other.pose.position;
        let mut corners = vec![nearest];
        for _ in 0..STEPS {
            let distance = nearest.length();
            if distance <= limit {
                return true;
            }
            let corner = self.furthest(-nearest) - other.furthest(nearest);
            if nearest.dot(corner) > limit * distance {
                return false;
            }
            corners.push(corner);
            (nearest, corners) = nearest_of(&corners);
        }
        true
    }
}

/// The point of a simplex of up to four corners that is nearest to zero, and the corners that it
/// lies between.
fn nearest_of(corners: &[DVec3]) -> (DVec3, Vec<DVec3>) {
    let parts = (1..1_usize << corners.len()).filter_map(|part| {
        let numbered = corners.iter().enumerate();
        let chosen = numbered.filter(|(index, _)| part >> index & 1 == 1);
        let chosen: Vec<DVec3> = chosen.map(|(_, corner)| *corner).collect();
        Some((foot(&chosen)?, chosen))
    });
    let nearest = parts.min_by(|(a, _), (b, _)| a.length_squared().total_cmp(&b.length_squared()));
    nearest.unwrap_or_default()
}

/// The point nearest to zero of the line, plane or space through all corners; none where it does
/// not lie between them.
fn foot(corners: &[DVec3]) -> Option<DVec3> {
    match *corners {
        [a] => Some(a),
        [a, b] => {
            let way = b - a;
            let part = -a.dot(way) / way.length_squared();
            (0.0..=1.0).contains(&part).then(|| a + part * way)
        }
        [a, b, c] => {
            let normal = (b - a).cross(c - a);
            let foot = normal * (a.dot(normal) / normal.length_squared());
            let inside = |from: DVec3, to: DVec3| (to - from).cross(foot - from).dot(normal) >= 0.0;
            (inside(a, b) && inside(b, c) && inside(c, a)).then_some(foot)
        }
        [a, b, c, d] => {
            let parts = DMat3::from_cols(b - a, c - a, d - a).inverse() * -a;
            let inside = parts.min_element() >= 0.0 && parts.element_sum() <= 1.0;
            inside.then_some(DVec3::ZERO)
        }
        _ => None,
    }
}

/// `true` where a shape of one link touches a shape of another one, their frames being in one
/// world.
pub(crate) fn touch([a, b]: [(&[PlacedShape], &Pose); 2]) -> bool {
    let solids = |(shapes, pose): (&[PlacedShape], &Pose)| -> Vec<Solid> {
        shapes.iter().map(|shape| Solid::new(shape, pose)).collect()
    };
    let [a, b] = [a, b].map(solids);
    a.iter().any(|one| b.iter().any(|other| one.touches(other)))
}
