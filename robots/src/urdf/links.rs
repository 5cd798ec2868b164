//! Links of a URDF: masses and collision shapes.

use glam::{DMat3, DVec3};

use super::Report;
use super::mesh::Meshes;
use super::xml::{Element, Found};
use crate::capsule::{PlacedShape, Shape, join_capsules};
use crate::description::{Inertia, Link};
use crate::fit::LEAST_SIZE;

/// Reads a link.
pub(super) fn link(link: Element, meshes: &Meshes, report: &mut Report) -> Link {
    let stated = link.child("inertial").map(inertia);
    let inertia = stated.and_then(|inertia| report.keep(inertia)).flatten();
    let mut shapes = Vec::new();
    for collision in link.children("collision") {
        let shape = shape(link.name(), collision, meshes, report);
        shapes.extend(report.keep(shape).flatten());
    }
    Link { name: link.name().to_owned(), inertia, shapes: join_capsules(shapes) }
}

/// Reads the mass and inertia of a link, which need not be those of a rigid body. `None` if all
/// numbers are zero.
fn inertia(inertial: Element) -> Found<Option<Inertia>> {
    let mass = inertial.child("mass").ok_or_else(|| inertial.missing("`<mass>`"))?;
    mass.text("value").ok_or_else(|| mass.missing("`value`"))?;
    let value = mass.number("value", 0.0)?;
    mass.require(value >= 0.0, "value", "zero or more kilograms")?;
    let stated = inertial.child("inertia");
    let of = |name| stated.map_or(Ok(0.0), |inertia| inertia.number(name, 0.0));
    let [xx, yy, zz, xy, xz, yz] = ["ixx", "iyy", "izz", "ixy", "ixz", "iyz"].map(of);
    let [xy, xz, yz] = [xy?, xz?, yz?];
    let own = DMat3::from_cols_array(&[xx?, xy, xz, xy, yy?, yz, xz, yz, zz?]);
    let pose = inertial.origin()?;
    let turn = DMat3::from_quat(pose.rotation);
    let inertia =
        Inertia { mass: value, centre: pose.position, tensor: turn * own * turn.transpose() };
    Ok((value > 0.0 || own != DMat3::ZERO).then_some(inertia))
}

/// Kinds of collision shapes.
const SHAPES: [&str; 5] = ["box", "cylinder", "capsule", "sphere", "mesh"];

/// Reads a shape. `None` for a shape that is left out.
fn shape(
    link: &str,
    collision: Element,
    meshes: &Meshes,
    report: &mut Report,
) -> Found<Option<PlacedShape>> {
    let pose = collision.origin()?;
    let geometry = collision.child("geometry").unwrap_or(collision);
    let found = SHAPES.iter().find_map(|&kind| Some((kind, geometry.child(kind)?)));
    let Some((kind, element)) = found else {
        return Err(geometry.missing("box, cylinder, sphere, capsule or mesh"));
    };
    if kind == "mesh" {
        let own = meshes.shape(link, element, report)?;
        return Ok(own.map(|own| PlacedShape { pose: pose * own.pose, shape: own.shape }));
    }
    let shape = match kind {
        "box" => {
            let size = element.vector("size", DVec3::ZERO)?;
            element.require(size.min_element() >= 0.0, "size", "zero or more metres")?;
            sized(size.to_array()).map(|size| Shape::Box { half: 0.5 * DVec3::from_array(size) })
        }
        "sphere" => sized([length(element, "radius")?]).map(|[radius]| Shape::Sphere { radius }),
        round => sized([length(element, "radius")?, length(element, "length")?]).map(
            |[radius, length]| match round {
                "cylinder" => Shape::Cylinder { radius, length },
                _ => Shape::Capsule { radius, length },
            },
        ),
    };
    if shape.is_none() {
        report.note(element, "it has no size and is left out");
    }
    Ok(shape.map(|shape| PlacedShape { pose, shape }))
}

fn length(shape: Element, attribute: &'static str) -> Found<f64> {
    let length = shape.number(attribute, 0.0)?;
    shape.require(length >= 0.0, attribute, "zero or more metres")?;
    Ok(length)
}

/// Enlarges sizes to [`LEAST_SIZE`]. `None` if all are smaller.
fn sized<const N: usize>(sizes: [f64; N]) -> Option<[f64; N]> {
    let any = sizes.iter().any(|&size| size >= LEAST_SIZE);
    any.then(|| sizes.map(|size| size.max(LEAST_SIZE)))
}
