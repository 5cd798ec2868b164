//! Links: inertias and what they collide as.

use std::path::Path;

use glam::DVec3;
use urdf_rs::Geometry;

use super::{inertia, mesh, origin};
use crate::capsule::{PlacedShape, Shape, join_capsules};
use crate::description::Link;
use crate::error::DescriptionError;
use crate::fit::LEAST_SIZE;
use crate::number::{finite, require};

/// A link whose meshes are below `folder`, if it is known.
pub(super) fn link(
    stated: &urdf_rs::Link,
    folder: Option<&Path>,
) -> Result<Link, DescriptionError> {
    for visual in &stated.visual {
        check_visual(&stated.name, visual)?;
    }
    let shapes = stated
        .collision
        .iter()
        .map(|collision| shape(&stated.name, collision, folder));
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
    let place = || format!("collision shape of link `{link}`");
    let size = |values: &[f64]| {
        finite(place, "a size", values)?;
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        require(
            least >= LEAST_SIZE,
            place,
            "a size",
            least,
            "a micrometre or more",
        )
    };
    let pose = origin(place, &collision.origin)?;
    let shape = match &collision.geometry {
        Geometry::Box { size: sizes } => {
            size(&sizes[..])?;
            let half = 0.5 * DVec3::from_array(**sizes);
            Shape::Box { half }
        }
        &Geometry::Cylinder { radius, length } => {
            size(&[radius, length])?;
            Shape::Cylinder { radius, length }
        }
        &Geometry::Capsule { radius, length } => {
            size(&[radius, length])?;
            Shape::Capsule { radius, length }
        }
        &Geometry::Sphere { radius } => {
            size(&[radius])?;
            Shape::Sphere { radius }
        }
        Geometry::Mesh { filename, scale } => {
            let scale = scale.map_or(DVec3::ONE, |scale| DVec3::from_array(*scale));
            let PlacedShape { pose: own, shape } = mesh::capsule(link, filename, scale, folder)?;
            return Ok(PlacedShape {
                pose: pose * own,
                shape,
            });
        }
    };
    Ok(PlacedShape { pose, shape })
}

/// What is only drawn is skipped. A file outside of the folder is refused all the same: other tools
/// would open it.
fn check_visual(link: &str, visual: &urdf_rs::Visual) -> Result<(), DescriptionError> {
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
