//! Links of a URDF: inertias and collision shapes.

use std::path::Path;

use glam::DVec3;
use urdf_rs::Geometry;

use super::{inertia, mesh, origin};
use crate::capsule::{PlacedShape, Shape, join_capsules};
use crate::description::Link;
use crate::error::DescriptionError;
use crate::error::{check_numbers, require};
use crate::fit::MIN_SHAPE_SIZE;
use crate::pose::Pose;

/// Converts a link; without a `folder`, collision meshes are rejected.
pub(super) fn link(
    stated: &urdf_rs::Link,
    folder: Option<&Path>,
) -> Result<Link, DescriptionError> {
    for visual in &stated.visual {
        check_visual(&stated.name, visual)?;
    }
    let shapes = stated.collision.iter().map(|collision| shape(&stated.name, collision, folder));
    Ok(Link {
        name: stated.name.clone(),
        inertia: inertia::inertia(stated)?,
        shapes: join_capsules(shapes.collect::<Result<_, _>>()?),
    })
}

fn shape(
    link: &str,
    collision: &urdf_rs::Collision,
    folder: Option<&Path>,
) -> Result<PlacedShape, DescriptionError> {
    let pose = origin(|| place(link), &collision.origin)?;
    let (own, shape) = unplaced(link, &collision.geometry, folder)?;
    let pose = own.map_or(pose, |own| pose * own);
    Ok(PlacedShape { pose, shape })
}

/// Converts a shape. Returns it with its pose in the frame of `<origin>`, which only a mesh has.
fn unplaced(
    link: &str,
    geometry: &Geometry,
    folder: Option<&Path>,
) -> Result<(Option<Pose>, Shape), DescriptionError> {
    let shape = match *geometry {
        Geometry::Box { size } => {
            Shape::Box { half_extents: 0.5 * DVec3::from_array(sized(link, *size)?) }
        }
        Geometry::Cylinder { radius, length } => {
            let [radius, length] = sized(link, [radius, length])?;
            Shape::Cylinder { radius, length }
        }
        Geometry::Capsule { radius, length } => {
            let [radius, length] = sized(link, [radius, length])?;
            Shape::Capsule { radius, length }
        }
        Geometry::Sphere { radius } => {
            let [radius] = sized(link, [radius])?;
            Shape::Sphere { radius }
        }
        Geometry::Mesh { ref filename, scale } => {
            let scale = scale.map_or(DVec3::ONE, |scale| DVec3::from_array(*scale));
            let PlacedShape { pose, shape } = mesh::capsule(link, filename, scale, folder)?;
            return Ok((Some(pose), shape));
        }
    };
    Ok((None, shape))
}

/// Rejects sizes that are not finite or below [`MIN_SHAPE_SIZE`], and returns the others.
fn sized<const N: usize>(link: &str, sizes: [f64; N]) -> Result<[f64; N], DescriptionError> {
    let (place, what) = (|| place(link), "a size");
    check_numbers(place, what, &sizes)?;
    let least = sizes.into_iter().fold(f64::INFINITY, f64::min);
    let holds = least >= MIN_SHAPE_SIZE;
    require(holds, place, what, least, "a micrometre or more")?;
    Ok(sizes)
}

fn place(link: &str) -> String {
    format!("collision shape of link `{link}`")
}

/// Rejects a visual shape that names a file outside of the URDF's folder.
fn check_visual(link: &str, visual: &urdf_rs::Visual) -> Result<(), DescriptionError> {
    // visual shapes are not used here, but other tools would open their files
    let material = visual.material.as_ref();
    let texture = material.and_then(|material| material.texture.as_ref());
    let mesh = match &visual.geometry {
        Geometry::Mesh { filename, .. } => Some(filename),
        _ => None,
    };
    let texture = texture.map(|texture| &texture.filename);
    let mut files = mesh.into_iter().chain(texture);
    files.try_for_each(|file| mesh::check_inside(link, file))
}
