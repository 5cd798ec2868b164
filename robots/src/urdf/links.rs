//! Links of a URDF: masses and collision shapes.

use glam::{DMat3, DVec3};
use urdf_rs::Geometry;

use super::Report;
use super::mesh::Meshes;
use crate::capsule::{PlacedShape, Shape, join_capsules};
use crate::description::{Inertia, Link};
use crate::fit::MIN_SHAPE_SIZE;
use crate::pose::Pose;

/// Converts a link of a URDF, whose element starts at `line`.
pub(super) fn link(
    stated: &urdf_rs::Link,
    line: usize,
    meshes: &Meshes,
    report: &mut Report,
) -> Link {
    let mut shapes = Vec::new();
    for collision in &stated.collision {
        let pose = pose(&collision.origin);
        match collision.geometry {
            Geometry::Mesh { ref filename, scale } => {
                let scale = scale.map_or(DVec3::ONE, |scale| DVec3::from_array(*scale));
                let own = meshes.shape(&stated.name, line, filename, scale, report);
                shapes.extend(own.map(|own| PlacedShape { pose: pose * own.pose, ..own }));
            }
            ref primitive => {
                let shape = primitive_shape(primitive, report.repair);
                shapes.extend(shape.map(|shape| PlacedShape { pose, shape }));
            }
        }
    }
    Link {
        name: stated.name.clone(),
        inertia: inertia(&stated.inertial),
        shapes: join_capsules(shapes),
    }
}

/// Converts the mass and inertia of a link, which need not be those of a rigid body. `None` if all
/// numbers are zero, as `urdf-rs` reads a missing `<inertial>`.
fn inertia(stated: &urdf_rs::Inertial) -> Option<Inertia> {
    let urdf_rs::Inertia { ixx, ixy, ixz, iyy, iyz, izz } = stated.inertia;
    let own = DMat3::from_cols_array(&[ixx, ixy, ixz, ixy, iyy, iyz, ixz, iyz, izz]);
    let mass = stated.mass.value;
    let is_massive = mass > 0.0 || own != DMat3::ZERO;
    let about_centre = Inertia { mass, centre_of_mass: DVec3::ZERO, tensor: own };
    is_massive.then(|| about_centre.in_frame(&pose(&stated.origin)))
}

/// Converts a shape other than a mesh. A repair enlarges sizes to [`MIN_SHAPE_SIZE`]; without it,
/// returns `None` if one is smaller.
fn primitive_shape(geometry: &Geometry, repair: bool) -> Option<Shape> {
    let sized = |size: f64| {
        let large = size.max(MIN_SHAPE_SIZE);
        (repair || large == size).then_some(large)
    };
    Some(match *geometry {
        Geometry::Box { size } => {
            let [x, y, z] = *size;
            Shape::Box { half_extents: 0.5 * DVec3::new(sized(x)?, sized(y)?, sized(z)?) }
        }
        Geometry::Cylinder { radius, length } => {
            Shape::Cylinder { radius: sized(radius)?, length: sized(length)? }
        }
        Geometry::Capsule { radius, length } => {
            Shape::Capsule { radius: sized(radius)?, length: sized(length)? }
        }
        Geometry::Sphere { radius } => Shape::Sphere { radius: sized(radius)? },
        Geometry::Mesh { .. } => return None,
    })
}

/// Converts the `<origin>` of a URDF element to a pose.
pub(super) fn pose(origin: &urdf_rs::Pose) -> Pose {
    Pose::from_xyz_rpy(*origin.xyz, *origin.rpy)
}
