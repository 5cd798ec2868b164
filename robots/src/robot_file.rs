//! Settings of a robot in a file: what its URDF does not say.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::Deserialize;
use serde_json::{Map, Value};

use crate::description::RobotDescription;
use crate::error::{DescriptionError, require};
use crate::urdf::UrdfSettings;

/// Names of the settings of a file, with the values that each takes.
const SETTINGS: [(&str, &str); 12] = [
    ("urdf", "the path of a URDF"),
    ("hand", "the name of a link"),
    ("approach_axis", "three numbers, such as [0, 0, 1]"),
    ("fingers", "the names of two links"),
    ("base_position", "three numbers, such as [0, -0.5, 0.1]"),
    ("base_yaw_degrees", "a number"),
    ("default_speed", "a number"),
    ("default_effort", "a number"),
    ("ignore_meshes", "true or false"),
    ("repair", "true or false"),
    ("packages", "folders by name, such as {\"arm\": \"../arm\"}"),
    ("mesh_root", "the path of a folder"),
];
/// Maximum number of characters of a value or line in a message.
const MAX_QUOTED: usize = 60;
/// Largest distance (metres) of a base from the centre of the table: beyond the reach of any arm.
const FARTHEST_BASE: f64 = 5.0;

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
        let invalid =
            |message| DescriptionError::InvalidSettings { path: path.to_owned(), message };
        let text = std::str::from_utf8(json)
            .map_err(|_| invalid("the file is not UTF-8; save it as UTF-8".to_owned()))?;
        let file: Self =
            serde_json::from_str(text).map_err(|error| invalid(problem(text, &error)))?;
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

    /// Rejects a base that no arm at the table can have.
    ///
    /// # Errors
    /// [`DescriptionError::NumberOutOfRange`].
    pub fn check_base(&self) -> Result<(), DescriptionError> {
        let place = || "the base".to_owned();
        let distance = DVec3::from_array(self.base_position.unwrap_or_default()).length();
        let what = "the distance of `base_position` from the centre of the table";
        let expected = "at most 5 metres; correct `base_position` in the settings";
        // comparisons that are false for NaN, too
        require(distance <= FARTHEST_BASE, place, what, distance, expected)?;
        let yaw = self.base_yaw_degrees.unwrap_or_default();
        let expected_yaw = "degrees from -360 to 360; correct it in the settings";
        require(yaw.abs() <= 360.0, place, "`base_yaw_degrees`", yaw, expected_yaw)
    }
}

/// Describes why `text` holds no settings of a robot, which `error` says in the words of a parser.
fn problem(text: &str, error: &serde_json::Error) -> String {
    let line = error.line();
    let tree = match serde_json::from_str(text) {
        Ok(tree) => tree,
        Err(syntax) => return syntax_problem(text, &syntax),
    };
    let Value::Object(settings) = tree else {
        return "expected an object, such as {\"urdf\": \"arm.urdf\"}".to_owned();
    };
    let wrong: Vec<String> = settings
        .iter()
        .filter_map(|(name, value)| wrong_setting(text, line, name, value))
        .collect();
    if !wrong.is_empty() {
        return wrong.join("\n");
    }
    if !settings.contains_key("urdf") {
        return "`urdf` is missing, expected the path of a URDF".to_owned();
    }
    let twice = error.to_string().split('`').nth(1).unwrap_or_default().to_owned();
    format!("line {line}: `{twice}` is given twice; remove one")
}

/// Describes where `text` is not valid JSON.
fn syntax_problem(text: &str, error: &serde_json::Error) -> String {
    let line = error.line();
    if error.is_eof() {
        return format!("line {line}: the file ends early; close all quotes and brackets");
    }
    // columns count bytes, so the quoted part begins early in a line beyond ASCII
    let start = error.column().saturating_sub(MAX_QUOTED / 2);
    let content = text.lines().nth(line - 1).unwrap_or_default();
    let start = start.min(content.chars().count().saturating_sub(MAX_QUOTED / 2));
    let near: String = content.chars().skip(start).take(MAX_QUOTED).collect();
    format!(
        "line {line} is not valid JSON near `{near}`: look for a missing comma, quote or bracket, \
         and for a number that is infinite or NaN"
    )
}

/// Describes what is wrong with one setting: its name or its value. `None` if it can be read.
fn wrong_setting(text: &str, line: usize, name: &str, value: &Value) -> Option<String> {
    let key = format!("\"{name}\"");
    let is_key = |at: usize| text[at + key.len()..].trim_start().starts_with(':');
    let found = text.match_indices(&key).map(|(at, _)| at).find(|&at| is_key(at));
    let place = found.map_or(line, |at| 1 + text[..at].matches('\n').count());
    let Some((_, expected)) = SETTINGS.iter().find(|(known, _)| *known == name) else {
        let known = SETTINGS.map(|(known, _)| format!("`{known}`")).join(", ");
        return Some(format!("line {place}: there is no setting `{name}`; there are {known}"));
    };
    let mut alone = Map::from_iter([("urdf".to_owned(), "".into())]);
    alone.insert(name.to_owned(), value.clone());
    let is_wrong = serde_json::from_value::<RobotFile>(alone.into()).is_err();
    let quoted: String = value.to_string().chars().take(MAX_QUOTED).collect();
    is_wrong.then(|| format!("line {place}: `{name}` is {quoted}, expected {expected}"))
}

fn is(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|own| own.eq_ignore_ascii_case(extension))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_explained_settings_are_those_that_are_read() {
        let error = serde_json::from_str::<RobotFile>(r#"{"": 1}"#).unwrap_err().to_string();
        let read: Vec<&str> = error.split('`').skip(3).step_by(2).collect();
        assert_eq!(read, SETTINGS.map(|(name, _)| name), "{error}");
    }
}
