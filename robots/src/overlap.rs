//! Overlap test of collision shapes by the GJK algorithm (Gilbert, Johnson, Keerthi 1988, "A fast
//! procedure for computing the distance between complex objects in three-dimensional space").

use glam::{DMat3, DVec3};

use crate::capsule::{PlacedShape, Shape};
use crate::pose::Pose;

/// Distance (metres) below which shapes count as touching. A scene may give shapes a contact margin
/// of that size, and within it MuJoCo already pushes them apart.
const CLEARANCE: f64 = 1e-3;
/// Maximum number of steps of the search. Shapes that are undecided then are at the clearance, up
/// to rounding.
const STEPS: usize = 100;

/// Convex shape in the world: all points within `radius` of a hull, a box, a cylinder, a segment or
/// a point.
#[derive(Clone, Copy)]
struct Solid<'a> {
    shape: &'a Shape,
    pose: Pose,
    radius: f64,
    /// Distance of the furthest point from the middle.
    reach: f64,
}

impl<'a> Solid<'a> {
    fn new(placed: &'a PlacedShape, link: &Pose) -> Self {
        let rounding = match placed.shape {
            Shape::Sphere { radius } | Shape::Capsule { radius, .. } => radius,
            Shape::Cylinder { .. } | Shape::Box { .. } | Shape::Hull(_) => 0.0,
        };
        let reach = match placed.shape {
            Shape::Sphere { radius } => radius,
            Shape::Capsule { radius, length } => radius + 0.5 * length,
            Shape::Cylinder { radius, length } => radius.hypot(0.5 * length),
            Shape::Box { half_extents } => half_extents.length(),
            Shape::Hull(ref hull) => {
                hull.points().iter().map(|point| point.length()).fold(0.0, f64::max)
            }
        };
        Self { shape: &placed.shape, pose: *link * placed.pose, radius: rounding, reach }
    }

    fn sphere(&self) -> Sphere {
        Sphere { centre: self.pose.position, radius: self.reach }
    }

    /// Returns the support point, without the radius: the point that lies furthest in `direction`.
    fn support(&self, direction: DVec3) -> DVec3 {
        let direction = self.pose.rotation.conjugate() * direction;
        let at_end = |length: f64| (0.5 * length).copysign(direction.z) * DVec3::Z;
        let point = match *self.shape {
            Shape::Sphere { .. } => DVec3::ZERO,
            Shape::Capsule { length, .. } => at_end(length),
            Shape::Cylinder { radius, length } => {
                let across = direction.with_z(0.0).normalize_or_zero();
                radius * across + at_end(length)
            }
            Shape::Box { half_extents } => half_extents.copysign(direction),
            Shape::Hull(ref hull) => hull.support(direction),
        };
        self.pose.transform_point(point)
    }

    /// Returns `true` if the distance to `other` is at most the clearance.
    fn touches(&self, other: &Solid) -> bool {
        if self.sphere().is_apart(&other.sphere()) {
            return false;
        }
        let limit = self.radius + other.radius + CLEARANCE;
        // differences of a point of one solid and a point of the other: the one nearest to zero so
        // far, and the corners of the simplex that contains it
        let between = self.pose.position - other.pose.position;
        let mut nearest = self.support(-between) - other.support(between);
        let mut corners = vec![nearest];
        for _ in 0..STEPS {
            let distance = nearest.length();
            if distance <= limit {
                return true;
            }
            let corner = self.support(-nearest) - other.support(nearest);
            // a plane across `nearest` separates the solids by more than the limit
            if nearest.dot(corner) > limit * distance {
                return false;
            }
            corners.push(corner);
            (nearest, corners) = nearest_of(&corners);
        }
        true
    }
}

impl PlacedShape {
    /// Returns the point of the shape, on a link at pose `link`, that lies furthest in `direction`,
    /// both in the world.
    pub fn furthest_point(&self, link: &Pose, direction: DVec3) -> DVec3 {
        let solid = Solid::new(self, link);
        solid.support(direction) + solid.radius * direction.normalize_or_zero()
    }
}

/// Returns the point of a simplex of up to four corners that is nearest to zero, and the corners of
/// the smallest face that contains it.
fn nearest_of(corners: &[DVec3]) -> (DVec3, Vec<DVec3>) {
    // each bit of `face` chooses a corner
    let faces = (1..1_usize << corners.len()).filter_map(|face| {
        let numbered = corners.iter().enumerate();
        let chosen = numbered.filter(|(index, _)| face >> index & 1 == 1);
        let chosen: Vec<DVec3> = chosen.map(|(_, corner)| *corner).collect();
        Some((foot(&chosen)?, chosen))
    });
    let nearest = faces.min_by(|(a, _), (b, _)| a.length_squared().total_cmp(&b.length_squared()));
    nearest.unwrap_or_default()
}

/// Projects zero onto the line, plane or space through all corners. `None` if the result does not
/// lie between them.
fn foot(corners: &[DVec3]) -> Option<DVec3> {
    match *corners {
        [a] => Some(a),
        [a, b] => {
            let edge = b - a;
            let part = -a.dot(edge) / edge.length_squared();
            (0.0..=1.0).contains(&part).then(|| a + part * edge)
        }
        [a, b, c] => {
            let normal = (b - a).cross(c - a);
            let foot = normal * (a.dot(normal) / normal.length_squared());
            let inside = |from: DVec3, to: DVec3| (to - from).cross(foot - from).dot(normal) >= 0.0;
            (inside(a, b) && inside(b, c) && inside(c, a)).then_some(foot)
        }
        [a, b, c, d] => {
            // barycentric coordinates of zero
            let parts = DMat3::from_cols(b - a, c - a, d - a).inverse() * -a;
            let inside = parts.min_element() >= 0.0 && parts.element_sum() <= 1.0;
            inside.then_some(DVec3::ZERO)
        }
        _ => None,
    }
}

/// Bounding sphere, which spares the full test of distant shapes.
#[derive(Clone, Copy)]
struct Sphere {
    centre: DVec3,
    radius: f64,
}

impl Sphere {
    /// Returns `true` if the contents of the spheres cannot touch.
    fn is_apart(&self, other: &Self) -> bool {
        let limit = self.radius + other.radius + CLEARANCE;
        self.centre.distance_squared(other.centre) > limit * limit
    }
}

/// Collision shapes of a link in the world, with a bounding sphere.
pub(crate) struct Solids<'a> {
    solids: Vec<Solid<'a>>,
    around: Sphere,
}

impl<'a> Solids<'a> {
    /// Places the shapes of a link whose pose in the world is `link`.
    pub(crate) fn new(shapes: &'a [PlacedShape], link: &Pose) -> Self {
        let solids: Vec<Solid> = shapes.iter().map(|shape| Solid::new(shape, link)).collect();
        let places = solids.iter().map(|solid| solid.pose.position);
        let centre = places.sum::<DVec3>() / solids.len().max(1) as f64;
        let reaches = solids.iter().map(|solid| solid.pose.position.distance(centre) + solid.reach);
        let radius = reaches.fold(0.0, f64::max);
        Self { solids, around: Sphere { centre, radius } }
    }

    /// Returns `true` if a shape of one link comes within 1 mm of a shape of the other one.
    pub(crate) fn touch(&self, other: &Solids) -> bool {
        let near = |solid: &&Solid| !solid.sphere().is_apart(&other.around);
        !self.around.is_apart(&other.around)
            && self
                .solids
                .iter()
                .filter(near)
                .any(|one| other.solids.iter().any(|of| one.touches(of)))
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;

    /// Pairs of shapes that a gap separates in the direction z.
    #[test]
    fn shapes_less_than_a_millimetre_apart_touch() {
        let ball = Shape::Sphere { radius: 0.05 };
        let (radius, length) = (0.03, 0.2);
        let cylinder = Shape::Cylinder { radius, length };
        let capsule = Shape::Capsule { radius, length };
        let cube = Shape::Box { half_extents: DVec3::new(0.1, 0.2, 0.05) };
        let beam = Shape::Box { half_extents: DVec3::new(0.1, 0.05, 0.05) };
        let lying = DQuat::from_rotation_y(0.5 * std::f64::consts::PI);
        // it stands on its rim
        let tilted = DQuat::from_rotation_y(0.6);
        let rim = 0.5 * length * 0.6_f64.cos() + radius * 0.6_f64.sin();
        let edge = DQuat::from_rotation_x(0.25 * std::f64::consts::PI);
        let half_diagonal = 0.05 * 2.0_f64.sqrt();
        let upright = DQuat::IDENTITY;
        // each with its turn and the height of its middle over its lowest point
        for ([lower, upper], above) in [
            ([&ball, &ball], [(upright, 0.05), (upright, 0.05)]),
            ([&cube, &cube], [(upright, 0.05), (upright, 0.05)]),
            ([&cube, &beam], [(upright, 0.05), (edge, half_diagonal)]),
            ([&cube, &cylinder], [(upright, 0.05), (tilted, rim)]),
            ([&cube, &cylinder], [(upright, 0.05), (upright, 0.1)]),
            ([&cube, &cylinder], [(upright, 0.05), (lying, 0.03)]),
            ([&capsule, &cube], [(upright, 0.13), (upright, 0.05)]),
            ([&capsule, &beam], [(lying, 0.03), (edge, half_diagonal)]),
            ([&ball, &capsule], [(upright, 0.05), (lying, 0.03)]),
        ] {
            let [(first, top), (second, bottom)] = above;
            let placed = |shape: &Shape, rotation, height| PlacedShape {
                pose: Pose { position: height * DVec3::Z, rotation },
                shape: shape.clone(),
            };
            for (gap, touch) in [(0.9e-3, true), (1.1e-3, false)] {
                let height = top + gap + bottom;
                let shapes = [placed(lower, first, 0.0), placed(upper, second, height)];
                let [one, other] = shapes
                    .each_ref()
                    .map(|of| Solids::new(std::slice::from_ref(of), &Pose::IDENTITY));
                let found = [one.touch(&other), other.touch(&one)];
                assert_eq!(found, [touch; 2], "{lower:?} {upper:?} {gap}");
            }
        }
    }

    /// The middle of a hull's bounding box may lie outside the hull.
    #[test]
    fn a_hull_does_not_touch_what_is_near_the_middle_of_its_box() {
        let tetrahedron = [crate::hull::mesh_shape(&[DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z])];
        let tetrahedron = Solids::new(&tetrahedron, &Pose::IDENTITY);
        // the face x + y + z = 1 is 0.289 m away from the ball's middle
        for (radius, touch) in [(0.05, false), (0.28, false), (0.29, true)] {
            let ball = [PlacedShape {
                pose: Pose::from_position(DVec3::splat(0.5)),
                shape: Shape::Sphere { radius },
            }];
            let ball = Solids::new(&ball, &Pose::IDENTITY);
            let found = [tetrahedron.touch(&ball), ball.touch(&tetrahedron)];
            assert_eq!(found, [touch; 2], "{radius}");
        }
    }

    /// Bounding spheres do not change the result.
    #[test]
    fn links_of_many_shapes_touch_where_one_shape_does() {
        let ball = |x: f64| PlacedShape {
            pose: Pose { position: x * DVec3::X, rotation: DQuat::IDENTITY },
            shape: Shape::Sphere { radius: 0.1 },
        };
        let row: Vec<_> = (0..20).map(|index| ball(f64::from(index))).collect();
        let row = Solids::new(&row, &Pose::IDENTITY);
        for (place, touch) in [(19.2, true), (19.3, false), (9.5, false), (9.15, true)] {
            let single = [ball(place)];
            let other = Solids::new(&single, &Pose::IDENTITY);
            assert_eq!((row.touch(&other), other.touch(&row)), (touch, touch), "{place}");
        }
        let nothing = Solids::new(&[], &Pose::IDENTITY);
        assert!(!nothing.touch(&row) && !row.touch(&nothing));
    }
}
