//! Robot descriptions from URDF: cleaned, parsed by `urdf-rs`, then validated.
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

use crate::description::RobotDescription;
use crate::error::{DescriptionError, all};
use crate::pose::Pose;

pub use names::MAX_LINKS;
pub use xml::MAX_URDF_BYTES;

/// Settings of reading a URDF file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UrdfSettings {
    /// Names and folders of ROS packages, for `package://NAME/PATH`. Other packages are searched in
    /// the URDF's folder and the five above it.
    pub packages: Vec<(String, PathBuf)>,
    /// Folder outside of which no mesh is read, except from `packages`. If `None`, the fifth folder
    /// above the URDF's.
    pub mesh_root: Option<PathBuf>,
    /// `true` if meshes are left out: links then collide only as their other shapes.
    pub ignore_meshes: bool,
    /// Maximum speed (rad/s, m/s) of joints for which the file states none, which control needs.
    pub default_speed: Option<f64>,
    /// Maximum torque or force (newton metres, newtons), likewise, which servos need.
    pub default_effort: Option<f64>,
    /// `true` if masses and inertias that cannot be simulated are replaced, with a note: moving
    /// links without mass get that of capsules of water around their shapes, or one gram, and
    /// impossible inertias become their mean in all directions. Conversion to MJCF refuses such a
    /// robot otherwise.
    pub repair: bool,
}

/// Findings while a file is read.
#[derive(Default)]
struct Report {
    errors: Vec<(usize, DescriptionError)>,
    notes: Vec<String>,
    unread_meshes: Vec<String>,
}

impl Report {
    /// Adds an error at a line, or in the whole file at line 0.
    fn reject(&mut self, line: usize, error: DescriptionError) {
        self.errors.push((line, error));
    }

    fn note(&mut self, line: usize, note: &str) {
        self.notes.push(format!("line {line}: {note}"));
    }

    /// Fails with the errors, if there are any, in the order of their lines.
    fn check(&mut self) -> Result<(), DescriptionError> {
        self.errors.sort_by_key(|(line, _)| *line);
        let errors = self.errors.drain(..).map(|(line, error)| match line {
            0 => error,
            line => DescriptionError::Line { line, error: Box::new(error) },
        });
        all(errors.collect())
    }
}

impl RobotDescription {
    /// Reads a URDF file, and the collision meshes that it names, with the default settings.
    ///
    /// # Errors
    /// Those of [`RobotDescription::from_urdf_file_with`].
    pub fn from_urdf_file(path: &Path) -> Result<Self, DescriptionError> {
        Self::from_urdf_file_with(path, &UrdfSettings::default())
    }

    /// Reads a URDF file, and the collision meshes that it names.
    ///
    /// A mesh (STL, OBJ or COLLADA) becomes a capsule that encloses its points.
    ///
    /// # Errors
    /// [`DescriptionError::Read`], and those of [`RobotDescription::from_urdf`].
    pub fn from_urdf_file_with(
        path: &Path,
        settings: &UrdfSettings,
    ) -> Result<Self, DescriptionError> {
        // the folder of a plain name is the empty path, which is no folder
        let folder = path.parent().filter(|folder| *folder != Path::new(""));
        let unread = |source| DescriptionError::Read { path: path.to_owned(), source };
        let bytes = read(path, MAX_URDF_BYTES).map_err(unread)?;
        Self::parse(&xml::decode(bytes), Some(folder.unwrap_or(Path::new("."))), settings)
    }

    /// Parses a URDF, without its collision meshes. Its root is at the world's origin;
    /// [`RobotDescription::with_base_pose`] moves it.
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
        let mut report = Report::default();
        let cleaned = xml::clean(text, &mut report)?;
        let file = urdf_rs::read_from_string(&cleaned.text)
            .map_err(|error| DescriptionError::InvalidSyntax { message: error.to_string() })?;
        names::check_counts(&file)?;
        let tree = tree::Tree::new(&file, &cleaned, &mut report)?;
        let lines: Vec<usize> = tree.joints.iter().map(|&at| cleaned.joint_lines[at]).collect();
        let (mut joints, num_dofs) = joints::joints(&file, &tree, &lines, settings, &mut report);
        let note = |joint: usize, note: String| report.note(lines[joint], &note);
        let restrictions = mimic::restrict(&mut joints, note);
        report.check()?;
        let meshes = mesh::Meshes::new(settings, folder);
        let links = tree
            .links
            .iter()
            .map(|&at| links::link(&file.links[at], cleaned.link_lines[at], &meshes, &mut report));
        let mut description = Self {
            links: links.collect(),
            joints,
            num_dofs,
            restrictions,
            notes: report.notes,
            unread_meshes: report.unread_meshes,
            base_pose: Pose::IDENTITY,
            name: file.name,
        };
        if settings.repair {
            let (inertias, defects) = description.simulated_inertias();
            for (link, inertia) in description.links.iter_mut().zip(inertias) {
                link.inertia = inertia;
            }
            description.notes.extend(defects.into_iter().map(|(_, assumed)| assumed));
        }
        Ok(description)
    }
}

/// Reads a file, up to one byte more than `limit`, which shows that it is too long.
fn read(path: &Path, limit: usize) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(limit as u64 + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}
