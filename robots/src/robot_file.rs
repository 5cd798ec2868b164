//! Settings of a robot in a file: what its URDF does not say.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::Deserialize;

use crate::description::RobotDescription;
use crate::error::DescriptionError;
use crate::urdf::UrdfSettings;

/// Robot arm as a user describes it: a URDF, and settings where the defaults do not fit.
///
/// [`RobotFile::read`] takes the URDF itself, or a JSON file with these fields, of which only
/// `urdf` is required.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotFile {
    /// Path of the URDF, relative to the folder of this file.
    pub urdf: PathBuf,
    /// Name of the hand's link; `None` for [`RobotDescription::default_hand_link`].
    #[serde(default)]
    pub hand: Option<String>,
    /// Axis of the hand, in its own frame, that points down at work; `None` for
    /// [`RobotDescription::default_approach_axis`].
    #[serde(default)]
    pub approach_axis: Option<[f64; 3]>,
    /// Names of the links of the hand's two fingers; `None` for
    /// [`RobotDescription::default_finger_links`].
    #[serde(default)]
    pub fingers: Option<[String; 2]>,
    /// Position of the base (metres; origin: centre of the table, y away from the robot, z up);
    /// `None` for one that fits the reach of the arm.
    #[serde(default)]
    pub base_position: Option<[f64; 3]>,
    /// Angle (degrees) by which the base is turned about z from the x axis of the table; `None` for
    /// 90 degrees, the base's x pointing across the table.
    #[serde(default)]
    pub base_yaw_degrees: Option<f64>,
    /// Maximum speed (rad/s, m/s) of joints without one in the URDF.
    #[serde(default)]
    pub default_speed: Option<f64>,
    /// Maximum torque or force (newton metres, newtons) of joints without one in the URDF.
    #[serde(default)]
    pub default_effort: Option<f64>,
    /// `true` if collision meshes are left out.
    #[serde(default)]
    pub ignore_meshes: bool,
    /// `true` if masses and inertias that cannot be simulated are replaced
    /// ([`UrdfSettings::repair`]).
    #[serde(default)]
    pub repair: bool,
    /// Folders of ROS packages by name, relative to the folder of this file.
    #[serde(default)]
    pub packages: BTreeMap<String, PathBuf>,
    /// Folder outside of which no mesh is read ([`UrdfSettings::mesh_root`]), relative to the
    /// folder of this file.
    #[serde(default)]
    pub mesh_root: Option<PathBuf>,
}

/// Returns the text of a file without the byte order mark of UTF-8, which editors of Windows write.
pub fn without_byte_order_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix("\u{feff}".as_bytes()).unwrap_or(bytes)
}

impl RobotFile {
    /// Returns `true` for names of a URDF (`.urdf`) or of a settings file (`.json`), in any case.
    pub fn has_supported_extension(path: &Path) -> bool {
        is(path, "urdf") || is(path, "json")
    }

    /// Reads the settings in a JSON file; any other file is taken for the URDF itself, unread, with
    /// default settings. Paths are relative to the working directory then.
    ///
    /// # Errors
    /// [`DescriptionError::Read`], [`DescriptionError::InvalidSettings`].
    pub fn read(path: &Path) -> Result<Self, DescriptionError> {
        if !is(path, "json") {
            return Ok(Self { urdf: path.to_owned(), ..Self::default() });
        }
        let bytes = std::fs::read(path)
            .map_err(|source| DescriptionError::Read { path: path.to_owned(), source })?;
        let json = without_byte_order_mark(&bytes);
        let file: Self = serde_json::from_slice(json).map_err(|error| {
            let message = error.to_string();
            DescriptionError::InvalidSettings { path: path.to_owned(), message }
        })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let packages = file.packages.into_iter().map(|(name, at)| (name, folder.join(at)));
        Ok(Self {
            urdf: folder.join(&file.urdf),
            packages: packages.collect(),
            mesh_root: file.mesh_root.map(|root| folder.join(root)),
            ..file
        })
    }

    /// Reads the URDF and the meshes that it names; the settings of hand and base are not applied.
    ///
    /// # Errors
    /// Those of [`RobotDescription::from_urdf_file_with_settings`]; they name the file.
    pub fn read_description(&self) -> Result<RobotDescription, DescriptionError> {
        let settings = UrdfSettings {
            packages: self.packages.clone().into_iter().collect(),
            mesh_root: self.mesh_root.clone(),
            ignore_meshes: self.ignore_meshes,
            default_speed: self.default_speed,
            default_effort: self.default_effort,
            repair: self.repair,
        };
        RobotDescription::from_urdf_file_with_settings(&self.urdf, &settings).map_err(|error| {
            match error {
                DescriptionError::Read { .. } => error,
                _ => DescriptionError::File { path: self.urdf.clone(), error: Box::new(error) },
            }
        })
    }

    /// Returns the name of the hand's link: that of this file, unchecked, or else the default of
    /// `robot`.
    pub fn hand_link<'a>(&'a self, robot: &'a RobotDescription) -> &'a str {
        self.hand.as_deref().unwrap_or(robot.default_hand_link())
    }

    /// Returns the names of the links of the hand's two fingers: those of this file, unchecked, or
    /// else the default of `robot`; `None` if nothing moves on the hand.
    ///
    /// # Errors
    /// Those of [`RobotDescription::default_finger_links`].
    pub fn finger_links(
        &self,
        robot: &RobotDescription,
    ) -> Result<Option<[String; 2]>, DescriptionError> {
        match &self.fingers {
            Some(names) => Ok(Some(names.clone())),
            None => robot.default_finger_links(self.hand_link(robot)),
        }
    }

    /// Returns the unit vector, in the frame of the hand, that points down at work: that of this
    /// file, or else the default of `robot`.
    ///
    /// # Errors
    /// Those of [`RobotDescription::default_approach_axis`];
    /// [`DescriptionError::NumberOutOfRange`] for an axis without direction.
    pub fn approach_axis(&self, robot: &RobotDescription) -> Result<DVec3, DescriptionError> {
        let hand = self.hand_link(robot);
        let Some(axis) = self.approach_axis else {
            return robot.default_approach_axis(hand);
        };
        let axis = DVec3::from_array(axis);
        axis.try_normalize().ok_or_else(|| DescriptionError::NumberOutOfRange {
            place: format!("the hand `{hand}`"),
            what: "the length of `approach_axis`",
            value: axis.length(),
            expected: "a finite length that is not zero",
        })
    }
}

fn is(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|own| own.eq_ignore_ascii_case(extension))
}
