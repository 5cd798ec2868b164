//! Collision shapes of links, and the capsules that enclose them.

use std::sync::Arc;

use glam::DVec3;

use crate::pose::Pose;

/// Capsule: all points within `radius` (metres) of a segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    /// Ends of the segment (metres); equal for a sphere.
    pub ends: [DVec3; 2],
    /// Distance from the segment to the surface (metres).
    pub radius: f64,
}

impl Capsule {
    /// Returns the signed distance of `point` from the surface (metres), negative inside.
    pub fn signed_distance_to_point(&self, point: DVec3) -> f64 {
        let [start, end] = self.ends;
        let (axis, way) = (end - start, point - start);
        // the axis of a sphere has length zero: avoid 0 / 0
        let along = way.dot(axis) / axis.length_squared().max(f64::MIN_POSITIVE);
        way.distance(along.clamp(0.0, 1.0) * axis) - self.radius
    }
}

/// Collision shape centred at the origin, sizes in metres; cylinders and capsules lie along z.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A sphere.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// A cylinder capped by two hemispheres.
    Capsule {
        /// Radius of the cylinder and of the hemispheres.
        radius: f64,
        /// Length of the cylinder, without the hemispheres.
        length: f64,
    },
    /// A cylinder.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Whole length along z.
        length: f64,
    },
    /// A box.
    Box {
        /// Half extents along x, y and z.
        half_extents: DVec3,
    },
    /// The convex hull of a mesh.
    Hull(Arc<ConvexHull>),
}

/// Collision shape at a pose in the frame of its link.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedShape {
    /// Pose of the shape in the frame of the link.
    pub pose: Pose,
    /// Kind and sizes of the shape.
    pub shape: Shape,
}

/// Convex hull of points, with capsules that enclose it.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvexHull {
    points: Vec<DVec3>,
    capsules: Vec<PlacedShape>,
}

impl ConvexHull {
    /// Creates the hull of `points` with `capsules` that enclose it.
    pub(crate) fn new(points: Vec<DVec3>, capsules: Vec<PlacedShape>) -> Self {
        Self { points, capsules }
    }

    /// Returns the points (metres), 204 at most, whose convex hull this is.
    pub fn points(&self) -> &[DVec3] {
        &self.points
    }

    /// Returns capsules that enclose the hull and all points of the mesh.
    pub(crate) fn capsules(&self) -> &[PlacedShape] {
        &self.capsules
    }

    /// Returns the point of the hull that lies furthest in `direction`.
    pub(crate) fn support(&self, direction: DVec3) -> DVec3 {
        furthest(&self.points, |point| point.dot(direction))
    }
}

/// Returns the point with the largest `measure`, on a tie the first; zero without points.
pub(crate) fn furthest(points: &[DVec3], measure: impl Fn(DVec3) -> f64) -> DVec3 {
    let mut best = (f64::NEG_INFINITY, DVec3::ZERO);
    for &point in points {
        let value = measure(point);
        if value > best.0 {
            best = (value, point);
        }
    }
    best.1
}

impl PlacedShape {
    /// Returns capsules, in the world, that enclose this shape of a link at pose `link`: one, or up
    /// to four around a hull.
    ///
    /// They are exact for spheres and capsules. A cylinder gains a hemisphere at each end; the
    /// capsule of a box lies along the box's longest axis and passes through its edges. Those of a
    /// hull lie along x, y or z of its mesh.
    pub fn enclosing_capsules(&self, link: &Pose) -> Vec<Capsule> {
        let (half, radius) = match self.shape {
            Shape::Hull(ref hull) => {
                let pose = *link * self.pose;
                return hull
                    .capsules()
                    .iter()
                    .flat_map(|of| of.enclosing_capsules(&pose))
                    .collect();
            }
            Shape::Sphere { radius } => (DVec3::ZERO, radius),
            Shape::Capsule { radius, length } | Shape::Cylinder { radius, length } => {
                (0.5 * length * DVec3::Z, radius)
            }
            Shape::Box { half_extents } => along_longest(half_extents),
        };
        let pose = *link * self.pose;
        vec![Capsule { ends: [pose.transform_point(-half), pose.transform_point(half)], radius }]
    }
}

fn along_longest(half: DVec3) -> (DVec3, f64) {
    let axis = DVec3::AXES[half.max_position()];
    let along = half * axis;
    (along, (half - along).length())
}

/// Largest difference (metres) between lengths of a file that count as equal: files round them.
const LENGTH_TOLERANCE: f64 = 1e-6;

/// Replaces every cylinder that has a sphere of its radius at both ends by one capsule.
///
/// Plain URDF has no capsule, and this is the usual way to write one.
pub(crate) fn join_capsules(shapes: Vec<PlacedShape>) -> Vec<PlacedShape> {
    let mut left: Vec<Option<PlacedShape>> = shapes.into_iter().map(Some).collect();
    for index in 0..left.len() {
        if let Some((capsule, caps)) = left[index].as_ref().and_then(|one| capsule_of(one, &left)) {
            left[index] = Some(capsule);
            for cap in caps {
                left[cap] = None;
            }
        }
    }
    left.into_iter().flatten().collect()
}

/// Returns the capsule that a cylinder is part of, and the indices of its two caps in `shapes`.
/// `None` if the shape is no cylinder or lacks a cap.
fn capsule_of(
    &PlacedShape { pose, ref shape }: &PlacedShape,
    shapes: &[Option<PlacedShape>],
) -> Option<(PlacedShape, [usize; 2])> {
    let &Shape::Cylinder { radius, length } = shape else {
        return None;
    };
    let cap = |side: f64| {
        let end = pose.transform_point(side * 0.5 * length * DVec3::Z);
        shapes
            .iter()
            .position(|other| other.as_ref().is_some_and(|other| is_cap(other, end, radius)))
    };
    let capsule = PlacedShape { pose, shape: Shape::Capsule { radius, length } };
    Some((capsule, [cap(-1.0)?, cap(1.0)?]))
}

fn is_cap(shape: &PlacedShape, end: DVec3, expected: f64) -> bool {
    match shape.shape {
        Shape::Sphere { radius } => {
            (radius - expected).abs() < LENGTH_TOLERANCE
                && shape.pose.position.distance(end) < LENGTH_TOLERANCE
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;

    fn placed(shape: Shape, position: DVec3) -> PlacedShape {
        PlacedShape { pose: Pose::from_position(position), shape }
    }

    #[test]
    fn a_capsule_holds_every_corner_of_its_box() {
        let half_extents = DVec3::new(0.1, 0.3, 0.2);
        let link = Pose::from_xyz_rpy([1.0, 2.0, 3.0], [0.3, -0.7, 2.0]);
        let shape = PlacedShape {
            pose: Pose::from_xyz_rpy([0.1, 0.0, -0.2], [1.0, 0.2, 0.0]),
            shape: Shape::Box { half_extents },
        };
        let capsule = shape.enclosing_capsules(&link)[0];
        assert!((capsule.radius - 0.05_f64.sqrt()).abs() < 1e-15);
        for corner in 0..8 {
            let sign = |bit: u32| if corner >> bit & 1 == 0 { -1.0 } else { 1.0 };
            let point = DVec3::new(sign(0), sign(1), sign(2)) * half_extents;
            let outside =
                capsule.signed_distance_to_point((link * shape.pose).transform_point(point));
            assert!(outside.abs() < 1e-12, "{outside}");
        }
        assert!(
            capsule.signed_distance_to_point((link * shape.pose).transform_point(1.9 * DVec3::Y))
                > 1.0
        );
    }

    #[test]
    fn a_cylinder_between_two_spheres_is_one_capsule() {
        let cylinder = Shape::Cylinder { radius: 0.1, length: 0.4 };
        let sphere = Shape::Sphere { radius: 0.1 };
        let at = DVec3::new(0.0, 1.0, 0.0);
        let turned = PlacedShape {
            pose: Pose { position: at, rotation: DQuat::from_rotation_x(0.3) },
            shape: cylinder,
        };
        let ends =
            [-0.2, 0.2].map(|z| placed(sphere.clone(), turned.pose.transform_point(z * DVec3::Z)));
        let joined = join_capsules(vec![ends[0].clone(), turned.clone(), ends[1].clone()]);
        let expected =
            PlacedShape { shape: Shape::Capsule { radius: 0.1, length: 0.4 }, ..turned.clone() };
        assert_eq!(joined, [expected]);
        // one cap alone, or caps of another size, are shapes of their own
        assert_eq!(join_capsules(vec![turned.clone(), ends[0].clone()]).len(), 2);
        let wider = ends.map(|end| placed(Shape::Sphere { radius: 0.11 }, end.pose.position));
        assert_eq!(join_capsules([vec![turned], wider.to_vec()].concat()).len(), 3);
    }
}
