//! Links: inertias and what they collide as.

use std::path::{Component, Path};

use glam::DVec3;
use urdf_rs::Geometry;

use super::{finite, inertia, origin, require};
use crate::capsule::{PlacedShape, Shape, join_capsules};
use crate::description::Link;
use crate::error::DescriptionError;

pub(super) fn link(stated: &urdf_rs::Link) -> Result<Link, DescriptionError> {
    for visual in &stated.visual {
        check_visual(&stated.name, visual)?;
    }
    let shapes = stated
        .collision
        .iter()
        .map(|collision| shape(&stated.name, collision));
    Ok(Link {
        name: stated.name.clone(),
        inertia: inertia::inertia(stated)?,
        shapes: join_capsules(shapes.collect::<Result<_, _>>()?),
    })
}

fn shape(link: &str, collision: &urdf_rs::Collision) -> Result<PlacedShape, DescriptionError> {
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
        Geometry::Mesh { filename, .. } => return Err(mesh(link, filename)),
    };
    let pose = origin(place, &collision.origin)?;
    Ok(PlacedShape { pose, shape })
}

/// Smallest size of a shape (metres).
const LEAST_SIZE: f64 = 1e-6;

fn mesh(link: &str, file: &str) -> DescriptionError {
    let (link, file) = (link.to_owned(), file.to_owned());
    if is_inside(&file) {
        DescriptionError::Mesh { link, file }
    } else {
        DescriptionError::FileOutside { link, file }
    }
}

/// What is only drawn is skipped. A file outside of the folder is refused all the same: other tools
/// would open it.
fn check_visual(link: &str, visual: &urdf_rs::Visual) -> Result<(), DescriptionError> {
    let texture = visual
        .material
        .as_ref()
        .and_then(|material| material.texture.as_ref());
    let mesh = match &visual.geometry {
        Geometry::Mesh { filename, .. } => Some(filename),
        _ => None,
    };
    let files = mesh
        .into_iter()
        .chain(texture.map(|texture| &texture.filename));
    match files.into_iter().find(|file| !is_inside(file)) {
        None => Ok(()),
        Some(file) => Err(DescriptionError::FileOutside {
            link: link.to_owned(),
            file: file.clone(),
        }),
    }
}

/// Whether a name leads to a file in the URDF's folder, or in a package of ROS.
fn is_inside(file: &str) -> bool {
    let path = file.strip_prefix("package://").unwrap_or(file);
    let plain = |part: Component<'_>| matches!(part, Component::Normal(_) | Component::CurDir);
    let parts = Path::new(path).components().all(plain);
    parts && !path.contains("://") && !path.contains('\\')
}

#[cfg(test)]
mod tests {
    use super::is_inside;

    #[test]
    fn files_outside_of_the_folder_are_told_from_those_inside() {
        for inside in [
            "a.stl",
            "meshes/a.stl",
            "./a.stl",
            "package://arm/meshes/a.stl",
        ] {
            assert!(is_inside(inside), "{inside}");
        }
        for outside in [
            "/etc/passwd",
            "../a.stl",
            "meshes/../../a.stl",
            "file:///etc/passwd",
            "https://host/a.stl",
            "package://../a.stl",
            "package:///etc/passwd",
            "..\\a.stl",
        ] {
            assert!(!is_inside(outside), "{outside}");
        }
    }
}
