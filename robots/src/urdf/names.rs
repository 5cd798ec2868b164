//! Checks of names and counts: names must be unique and usable in MuJoCo.

use std::collections::HashSet;

use crate::error::DescriptionError;

/// Maximum number of links of a robot.
pub const MAX_LINKS: usize = 1000;
/// Maximum number of collision shapes of a link.
const MAX_SHAPES: usize = 1000;
/// Maximum length of a name (bytes).
const MAX_NAME: usize = 200;

/// Rejects names that are empty, too long, unprintable or not unique, and files with too many links
/// or shapes, which could exhaust the memory.
pub(super) fn check(file: &urdf_rs::Robot) -> Result<(), DescriptionError> {
    count(|| "the robot".to_owned(), "link", file.links.len(), 1, MAX_LINKS)?;
    // a robot may go without a name
    if !file.name.is_empty() {
        usable("robot", &file.name)?;
    }
    file.links.iter().try_for_each(|link| not_reserved(file, link))?;
    unique("link", file.links.iter().map(|link| &link.name[..]))?;
    unique("joint", file.joints.iter().map(|joint| &joint.name[..]))?;
    file.links.iter().try_for_each(|link| {
        let place = || format!("the link `{}`", link.name);
        count(place, "collision shape", link.collision.len(), 0, MAX_SHAPES)
    })
}

fn count(
    place: impl Fn() -> String,
    kind: &'static str,
    count: usize,
    least: usize,
    limit: usize,
) -> Result<(), DescriptionError> {
    if (least..=limit).contains(&count) {
        return Ok(());
    }
    Err(DescriptionError::CountOutOfRange { place: place(), kind, count, least, limit })
}

fn unique<'a>(
    kind: &'static str,
    names: impl Iterator<Item = &'a str>,
) -> Result<(), DescriptionError> {
    let mut seen = HashSet::new();
    for name in names {
        usable(kind, name)?;
        if !seen.insert(name) {
            let name = name.to_owned();
            return Err(DescriptionError::Duplicate { kind, name });
        }
    }
    Ok(())
}

fn usable(kind: &'static str, name: &str) -> Result<(), DescriptionError> {
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
    Err(DescriptionError::InvalidName { kind, name, reason })
}

/// Rejects a link `world` that is not a bare root.
fn not_reserved(file: &urdf_rs::Robot, link: &urdf_rs::Link) -> Result<(), DescriptionError> {
    // MuJoCo reserves the name for the world's body; many files use it for a root without shapes
    let is_root = || file.joints.iter().all(|joint| joint.child.link != link.name);
    let is_bare = || link.collision.is_empty() && link.inertial.mass.value == 0.0;
    if link.name != "world" || (is_bare() && is_root()) {
        return Ok(());
    }
    Err(DescriptionError::InvalidName {
        kind: "link",
        name: link.name.clone(),
        reason: "it is reserved for the simulated world and a root without shapes and mass",
    })
}
