//! Robot descriptions from URDF: parsed by `urdf-rs`, then validated.
//!
//! `urdf-rs` accepts graphs that are no trees and numbers that are not finite, and fills in zeros
//! for missing elements. The modules below check all of that.

mod inertia;
mod joints;
mod links;
mod mesh;
mod mimic;
mod names;
mod tree;
mod xml;

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use crate::description::RobotDescription;
use crate::error::DescriptionError;
use crate::error::check_numbers;
use crate::pose::Pose;

pub use names::MAX_LINKS;
pub use xml::{MAX_URDF_BYTES, MAX_XML_DEPTH};

impl RobotDescription {
    /// Reads a URDF file, and the collision meshes in its folder.
    ///
    /// A mesh (STL or OBJ) becomes a capsule that encloses its points. `package://NAME/PATH` is
    /// looked up as `PATH` in the URDF's folder.
    ///
    /// # Errors
    /// [`DescriptionError::Read`], and errors of [`RobotDescription::from_urdf`].
    pub fn from_urdf_file(path: &Path) -> Result<Self, DescriptionError> {
        // the folder of a plain name is the empty path, which is no folder
        let folder = path.parent().filter(|folder| *folder != Path::new(""));
        Self::parse(&text(path)?, Some(folder.unwrap_or(Path::new("."))))
    }

    /// Parses a URDF without collision meshes. Its root is at the world's origin;
    /// [`RobotDescription::with_base_pose`] moves it.
    ///
    /// Reads `<inertial>` and `<collision>` (boxes, cylinders, spheres, capsules) of links, and
    /// everything but `<safety_controller>` and `<calibration>` of joints. Everything else is
    /// skipped. Units are those of URDF: metres, kilograms, seconds, radians.
    ///
    /// # Errors
    /// A [`DescriptionError`] that names the link or joint and the defect, for anything but a
    /// valid robot.
    pub fn from_urdf(text: &str) -> Result<Self, DescriptionError> {
        Self::parse(text, None)
    }

    fn parse(text: &str, folder: Option<&Path>) -> Result<Self, DescriptionError> {
        let elements = xml::elements(text)?;
        let file = urdf_rs::read_from_string(&elements)
            .map_err(|error| DescriptionError::InvalidSyntax { message: error.to_string() })?;
        names::check(&file)?;
        let tree = tree::Tree::new(&file)?;
        let link = |&index: &usize| links::link(&file.links[index], folder);
        let links = tree.links.iter().map(link);
        let (mut joints, num_dofs) = joints::joints(&file, &tree)?;
        let restrictions = mimic::restrict(&mut joints)?;
        let description = Self {
            links: links.collect::<Result<_, _>>()?,
            joints,
            num_dofs,
            restrictions,
            base_pose: Pose::IDENTITY,
            name: file.name,
        };
        inertia::check_moving(&description)?;
        Ok(description)
    }
}

/// Reads a file, up to one byte more than [`MAX_URDF_BYTES`], which shows that it is too long.
fn text(path: &Path) -> Result<String, DescriptionError> {
    let read = || -> io::Result<String> {
        let mut text = String::new();
        let limit = MAX_URDF_BYTES as u64 + 1;
        File::open(path)?.take(limit).read_to_string(&mut text)?;
        Ok(text)
    };
    read().map_err(|source| DescriptionError::Read { path: path.to_owned(), source })
}

/// Converts an `<origin>`, which must hold finite numbers.
fn origin(place: impl Fn() -> String, origin: &urdf_rs::Pose) -> Result<Pose, DescriptionError> {
    check_numbers(&place, "the origin's xyz", &*origin.xyz)?;
    check_numbers(&place, "the origin's rpy", &*origin.rpy)?;
    Ok(Pose::from_xyz_rpy(*origin.xyz, *origin.rpy))
}
