//! Robot descriptions from URDF.
//!
//! Reading refuses only what leaves the kinematics undefined. What else a file lacks (limits,
//! masses, meshes) is an error where it is needed: in control, servos and MJCF.

mod collada;
mod joints;
mod links;
mod mesh;
mod mimic;
mod names;
mod tree;
mod xml;

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use crate::description::{Description, Link};
use crate::error::{DescriptionError, LARGEST, all, require};
use crate::pose::Pose;
use joints::StatedJoint;
use tree::Tree;

pub use names::MAX_LINKS;
pub use xml::MAX_BYTES;

/// Settings of reading a URDF file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UrdfSettings {
    /// Names of ROS packages and their folders: `package://NAME/PATH` is `PATH` in that folder.
    /// Other packages are searched in the URDF's folder and the five above it.
    pub packages: Vec<(String, PathBuf)>,
    /// Folder outside of which no mesh is read, except from `packages`. If `None`, the fifth folder
    /// above the URDF's.
    pub root: Option<PathBuf>,
    /// `true` if meshes are left out: links then collide only as their other shapes.
    pub ignore_meshes: bool,
    /// Maximum speed (rad/s, m/s) of joints for which the file states none. If `None`, they have
    /// none, and control refuses them.
    pub speed: Option<f64>,
    /// Maximum torque or force (newton metres, newtons), likewise, which servos need.
    pub effort: Option<f64>,
    /// `true` if masses and inertias that cannot be simulated are replaced, with a note: moving
    /// links without mass get that of water in boxes around their shapes (one gram without shapes),
    /// and impossible inertias become their mean in all directions. If `false`, conversion to MJCF
    /// refuses such a robot.
    pub repair: bool,
}

impl UrdfSettings {
    /// Returns settings that fill in what a file lacks: speeds of 0.5 rad/s or m/s, efforts of 50 N
    /// m or N, and masses.
    pub fn forgiving() -> Self {
        Self { speed: Some(0.5), effort: Some(50.0), repair: true, ..Self::default() }
    }

    fn check(&self) -> Result<(), DescriptionError> {
        let place = || "the settings of the URDF".to_owned();
        for (what, value) in [("the speed", self.speed), ("the effort", self.effort)] {
            let value = value.unwrap_or(1.0);
            let holds = value > 0.0 && value <= LARGEST;
            require(holds, place, what, value, "a positive number up to 1e6")?;
        }
        Ok(())
    }
}

/// Findings while a file is read.
#[derive(Default)]
struct Report {
    errors: Vec<DescriptionError>,
    notes: Vec<String>,
    unread: Vec<String>,
}

impl Report {
    /// Returns the value, or `None` after adding the error.
    fn keep<T>(&mut self, found: Result<T, DescriptionError>) -> Option<T> {
        found.map_err(|error| self.errors.push(error)).ok()
    }

    /// Returns the errors in the order of their lines.
    fn error(mut self) -> DescriptionError {
        self.errors.sort_by_key(|error| match error {
            DescriptionError::Line { line, .. } => *line,
            _ => 0,
        });
        all(self.errors)
    }

    fn note(&mut self, element: xml::Element, note: &str) {
        self.notes.push(format!("line {}: {}: {note}", element.line(), element.place()));
    }
}

impl Description {
    /// Reads a URDF file, and the collision meshes that it names, with the default settings.
    ///
    /// # Errors
    /// Those of [`Description::read_with`].
    pub fn read(path: &Path) -> Result<Self, DescriptionError> {
        Self::read_with(path, &UrdfSettings::default())
    }

    /// Reads a URDF file, and the collision meshes that it names.
    ///
    /// A mesh (STL, OBJ or COLLADA) becomes a capsule that encloses its points.
    ///
    /// # Errors
    /// [`DescriptionError::Read`], [`DescriptionError::Number`] for settings that are not
    /// positive, and those of [`Description::from_urdf`].
    pub fn read_with(path: &Path, settings: &UrdfSettings) -> Result<Self, DescriptionError> {
        // the folder of a plain name is the empty path, which is no folder
        let folder = path.parent().filter(|folder| *folder != Path::new(""));
        Self::parse(&text(path)?, Some(folder.unwrap_or(Path::new("."))), settings)
    }

    /// Parses a URDF, without its collision meshes. Its root is at the world's origin;
    /// [`Description::placed`] moves it.
    ///
    /// Reads `<inertial>` and `<collision>` (boxes, cylinders, spheres, capsules) of links, and
    /// everything but `<safety_controller>` and `<calibration>` of joints. Everything else is
    /// skipped. Units are those of URDF: metres, kilograms, seconds, radians.
    ///
    /// # Errors
    /// A [`DescriptionError`] that names line, link or joint and the defect;
    /// [`DescriptionError::Several`] for several defects.
    pub fn from_urdf(text: &str) -> Result<Self, DescriptionError> {
        Self::parse(text, None, &UrdfSettings::default())
    }

    fn parse(
        text: &str,
        folder: Option<&Path>,
        settings: &UrdfSettings,
    ) -> Result<Self, DescriptionError> {
        settings.check()?;
        let text = xml::prepared(text)?;
        let document = xml::parse(&text)?;
        let robot = xml::robot(&document)?;
        let [links, elements] =
            ["link", "joint"].map(|name| robot.children(name).collect::<Vec<_>>());
        names::count(&links)?;
        let mut report = Report::default();
        names::check(robot, &links, &elements, &mut report);
        let stated = elements.iter().map(|&joint| StatedJoint::new(joint, settings, &mut report));
        let stated: Vec<StatedJoint> = stated.collect();
        let tree = Tree::new(&links, &stated, &mut report);
        let meshes = mesh::Meshes::new(settings, folder);
        let read = links.iter().map(|&link| links::link(link, &meshes, &mut report));
        let links: Vec<Link> = read.collect();
        let Some(tree) = tree else {
            return Err(report.error());
        };
        let (mut joints, dofs) = joints::resolve(stated, &tree, &mut report);
        let restrictions = mimic::restrict(&mut joints, |joint, note| {
            report.note(elements[tree.joints[joint]], &note);
        });
        if !report.errors.is_empty() {
            return Err(report.error());
        }
        let description = Self {
            links: tree.links.iter().map(|&link| links[link].clone()).collect(),
            joints,
            dofs,
            restrictions,
            notes: report.notes,
            unread: report.unread,
            base: Pose::IDENTITY,
            name: robot.name().to_owned(),
        };
        Ok(if settings.repair { description.repaired() } else { description })
    }
}

/// Reads a file, up to one byte more than [`MAX_BYTES`], which shows that it is too long.
fn text(path: &Path) -> Result<String, DescriptionError> {
    let read = || -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let limit = MAX_BYTES as u64 + 1;
        File::open(path)?.take(limit).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    let bytes =
        read().map_err(|source| DescriptionError::Read { path: path.to_owned(), source })?;
    Ok(xml::decode(bytes))
}
