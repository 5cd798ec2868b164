//! Checks of names and counts: names must be unique and usable in MuJoCo.

use std::collections::HashSet;

use super::Report;
use super::xml::Cleaned;
use crate::description::{MAX_LINKS, MAX_SHAPES, check_name};
use crate::error::{DescriptionError, require_count};

/// Rejects files without links, and with so many links, joints or shapes that they could exhaust
/// the memory.
pub(super) fn check_counts(file: &urdf_rs::Robot) -> Result<(), DescriptionError> {
    let robot = || "the robot".to_owned();
    require_count(robot, "link", file.links.len(), 1..=MAX_LINKS)?;
    require_count(robot, "joint", file.joints.len(), 0..=MAX_LINKS)?;
    file.links.iter().try_for_each(|link| {
        let place = || format!("the link `{}`", link.name);
        require_count(place, "collision shape", link.collision.len(), 0..=MAX_SHAPES)
    })
}

/// Reports names in a URDF that are empty, too long, unprintable or not unique; returns `true` if
/// there are none.
pub(super) fn check(file: &urdf_rs::Robot, cleaned: &Cleaned, report: &mut Report) -> bool {
    let before = report.errors.len();
    // a robot may go without a name
    if !file.name.is_empty() {
        usable("robot", &file.name, 0, report);
    }
    let links = file.links.iter().map(|link| &link.name[..]).zip(&cleaned.link_lines);
    let joints = file.joints.iter().map(|joint| &joint.name[..]).zip(&cleaned.joint_lines);
    unique("link", links, report);
    unique("joint", joints, report);
    report.errors.len() == before
}

fn unique<'a>(
    kind: &'static str,
    names: impl Iterator<Item = (&'a str, &'a usize)>,
    report: &mut Report,
) {
    let mut seen = HashSet::new();
    for (name, &line) in names {
        usable(kind, name, line, report);
        if !seen.insert(name) {
            report.reject(line, DescriptionError::Duplicate { kind, name: name.to_owned() });
        }
    }
}

fn usable(kind: &'static str, name: &str, line: usize, report: &mut Report) {
    if let Err(error) = check_name(kind, name) {
        report.reject(line, error);
    }
}
