//! Checks of names and counts: names must be unique and usable in MuJoCo.

use std::collections::HashSet;

use super::Report;
use super::xml::Element;
use crate::error::DescriptionError;

/// Maximum number of links of a robot.
pub const MAX_LINKS: usize = 1000;
/// Maximum number of collision shapes of a link.
const MAX_SHAPES: usize = 1000;
/// Maximum length of a name (bytes).
const MAX_NAME: usize = 200;

/// Rejects files with too many links or shapes, which could exhaust the memory.
pub(super) fn count(links: &[Element]) -> Result<(), DescriptionError> {
    within("the robot", "link", links.len(), 1, MAX_LINKS)?;
    links.iter().try_for_each(|link| {
        let shapes = link.children("collision").count();
        within(&link.place(), "collision shape", shapes, 0, MAX_SHAPES)
    })
}

fn within(
    place: &str,
    kind: &'static str,
    count: usize,
    least: usize,
    limit: usize,
) -> Result<(), DescriptionError> {
    if (least..=limit).contains(&count) {
        return Ok(());
    }
    Err(DescriptionError::Count { place: place.to_owned(), kind, count, least, limit })
}

/// Reports names that are empty, too long, unprintable or not unique.
pub(super) fn check(robot: Element, links: &[Element], joints: &[Element], report: &mut Report) {
    // a robot may go without a name
    if !robot.name().is_empty() {
        report.keep(usable("robot", robot));
    }
    for (kind, elements) in [("link", links), ("joint", joints)] {
        let mut seen = HashSet::new();
        for &element in elements {
            let name = element.name();
            report.keep(usable(kind, element));
            if !seen.insert(name) {
                let name = name.to_owned();
                report.errors.push(element.at(DescriptionError::Duplicate { kind, name }));
            }
        }
    }
}

fn usable(kind: &'static str, element: Element) -> Result<(), DescriptionError> {
    let name = element.name();
    let reason = if name.is_empty() {
        "it is empty"
    } else if name.len() > MAX_NAME {
        "it has more than 200 bytes"
    } else if name.chars().any(char::is_control) {
        "it holds a control character"
    } else {
        return Ok(());
    };
    // cut, because it becomes part of a message
    let name = name.chars().take(MAX_NAME).collect();
    Err(element.at(DescriptionError::Name { kind, name, reason }))
}
