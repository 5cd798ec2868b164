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

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use crate::description::RobotDescription;
use crate::error::{DescriptionError, all, require};
use crate::pose::Pose;

pub use xml::MAX_URDF_BYTES;

/// Settings for reading a URDF file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UrdfSettings {
    /// Folders of ROS packages by name, for `package://NAME/PATH`. A mesh of such a package that is
    /// not there is an error. Other packages are searched around the URDF: folders called `NAME` in
    /// its folder and the five above it, then those of the six whose `package.xml` states `NAME`,
    /// then, with a note, those without a `package.xml`.
    pub packages: BTreeMap<String, PathBuf>,
    /// Folder outside of which no mesh is read, except from `packages`. If `None`, the fifth folder
    /// above the URDF's.
    pub mesh_root: Option<PathBuf>,
    /// `true` if meshes are left out: links then collide only as their other shapes.
    pub ignore_meshes: bool,
    /// Maximum speed (rad/s, m/s) of joints for which the file states none, which control needs;
    /// 1e-6 or more and below 1e6.
    pub default_speed: Option<f64>,
    /// Maximum torque or force (newton metres, newtons) of joints for which the file states none,
    /// which servos need; 1e-6 or more and below 1e6.
    pub default_effort: Option<f64>,
    /// `true` if values that cannot be simulated are replaced, with a note: moving links without
    /// mass get that of capsules of water around their shapes, or one gram, impossible inertias
    /// become their mean in all directions, and sizes below 1e-6 m become 1e-6 m. Conversion to
    /// MJCF refuses such a robot otherwise.
    pub repair: bool,
}

impl UrdfSettings {
    fn check(&self) -> Result<(), DescriptionError> {
        let defaults = [
            ("`UrdfSettings::default_speed`", self.default_speed),
            ("`UrdfSettings::default_effort`", self.default_effort),
        ];
        defaults.into_iter().try_for_each(|(name, value)| {
            let is_limit = value.is_none_or(joints::is_limit);
            let (place, expected) = (|| "the settings".to_owned(), "at least 1e-6 and below 1e6");
            require(is_limit, place, name, value.unwrap_or_default(), expected)
        })
    }
}

/// Findings while a file is read. Line 0 stands for the whole file.
#[derive(Default)]
struct Report {
    /// [`UrdfSettings::repair`].
    repair: bool,
    errors: Vec<(usize, DescriptionError)>,
    notes: Vec<String>,
    unit_warnings: Vec<String>,
    missing_shapes: Vec<String>,
}

impl Report {
    fn reject(&mut self, line: usize, error: DescriptionError) {
        self.errors.push((line, error));
    }

    /// Adds a note; on the whole file, unless it is there already.
    fn note(&mut self, line: usize, note: &str) {
        if line > 0 {
            self.notes.push(format!("line {line}: {note}"));
        } else if self.notes.iter().all(|other| other != note) {
            self.notes.push(note.to_owned());
        }
    }

    /// Reports a size below 1e-6 m, which a repair enlarges.
    fn small_size(&mut self, line: usize, problem: &str) {
        if self.repair {
            self.note(line, &format!("{problem}; 1e-6 m is assumed"));
        } else {
            self.missing_shapes.push(format!("line {line}: {problem}"));
        }
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
    /// Those of [`RobotDescription::from_urdf_file_with_settings`].
    pub fn from_urdf_file(path: &Path) -> Result<Self, DescriptionError> {
        Self::from_urdf_file_with_settings(path, &UrdfSettings::default())
    }

    /// Reads a URDF file, and the collision meshes that it names.
    ///
    /// A mesh (STL, OBJ or COLLADA) becomes the convex hull of its points. One that cannot be read
    /// is left out and named by [`RobotDescription::missing_shape_reasons`].
    ///
    /// # Errors
    /// [`DescriptionError::Read`], [`DescriptionError::InvalidFolder`] and
    /// [`DescriptionError::NumberOutOfRange`] for settings, and those of
    /// [`RobotDescription::from_urdf`].
    pub fn from_urdf_file_with_settings(
        path: &Path,
        settings: &UrdfSettings,
    ) -> Result<Self, DescriptionError> {
        // the folder of a plain name is the empty path, which is no folder
        let folder = path.parent().filter(|folder| *folder != Path::new(""));
        let unread = |source| DescriptionError::Read { path: path.to_owned(), source };
        let bytes = read(path, MAX_URDF_BYTES).map_err(unread)?;
        let text = xml::decode(bytes.clone());
        let mut robot = Self::parse(&text, Some(folder.unwrap_or(Path::new("."))), settings)?;
        robot.notes.extend(xml::encoding_note(&bytes, &text).map(str::to_owned));
        Ok(robot)
    }

    /// Parses the text of a URDF without its collision meshes, which then count as missing. Its
    /// root is at the world's origin; [`RobotDescription::with_base_pose`] moves it.
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
        let meshes = mesh::Meshes::new(settings, folder)?;
        let mut report = Report { repair: settings.repair, ..Report::default() };
        let cleaned = xml::clean(text, &mut report)?;
        let file = urdf_rs::read_from_string(&cleaned.text)
            .map_err(|error| DescriptionError::InvalidSyntax { message: error.to_string() })?;
        names::check_counts(&file)?;
        let tree = tree::Tree::new(&file, &cleaned, &mut report)?;
        let lines: Vec<usize> = tree.joints.iter().map(|&at| cleaned.joint_lines[at]).collect();
        let (mut joints, num_dofs) = joints::joints(&file, &tree, &lines, settings, &mut report);
        let note = |joint: usize, note: String| report.note(lines[joint], &note);
        let restrictions = mimic::restrict(&mut joints, note);
        let link_lines: Vec<usize> = tree.links.iter().map(|&at| cleaned.link_lines[at]).collect();
        let stated = tree.links.iter().zip(&link_lines);
        let links =
            stated.map(|(&at, &line)| links::link(&file.links[at], line, &meshes, &mut report));
        let links = links.collect();
        report.check()?;
        let mut description = Self {
            links,
            joints,
            num_dofs,
            restrictions,
            notes: Vec::new(),
            unit_warnings: Vec::new(),
            missing_shapes: Vec::new(),
            base_pose: Pose::IDENTITY,
            name: file.name,
        };
        let (inertias, findings) = description.simulated_inertias();
        for finding in findings.iter().filter(|of| settings.repair || of.error.is_none()) {
            report.note(link_lines[finding.link], &finding.note);
            if finding.error.is_some() {
                description.links[finding.link].inertia = inertias[finding.link];
            }
        }
        let Report { notes, unit_warnings, missing_shapes, .. } = report;
        Ok(Self { notes, unit_warnings, missing_shapes, ..description })
    }
}

/// Reads a file, up to one byte more than `limit`, which shows that it is too long.
fn read(path: &Path, limit: usize) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(limit as u64 + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}
