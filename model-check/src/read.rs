//! Reading of models with the files that they name.

use std::fs;
use std::path::{Path, PathBuf};

use mujoco::Model;
use robots::{MjcfSettings, RobotFile};

use crate::error::ModelSymmetryError;

/// Reads and compiles an MJCF file with the files that it names, or the URDF of a robot, or the JSON
/// file of settings that names one ([`RobotFile`]).
///
/// # Errors
/// [`ModelSymmetryError::Read`], [`ModelSymmetryError::InvalidFile`],
/// [`ModelSymmetryError::Model`], [`ModelSymmetryError::Robot`].
pub fn read_model(path: &Path) -> Result<Model, ModelSymmetryError> {
    if RobotFile::has_supported_extension(path) {
        let robot = RobotFile::read(path)?.read_description()?;
        return Ok(Model::from_xml(&robot.to_mjcf(&MjcfSettings::default())?.text)?);
    }
    let mut files = Vec::new();
    add_file(path, path.parent().unwrap_or(Path::new("")), &mut files)?;
    let files: Vec<(&str, &[u8])> =
        files.iter().map(|(name, content)| (&name[..], &content[..])).collect();
    Ok(Model::from_files(files[0].0, &files)?)
}

/// Adds a file, and if it is XML, the files that it names, each by its plain name.
fn add_file(
    path: &Path,
    root: &Path,
    files: &mut Vec<(String, Vec<u8>)>,
) -> Result<(), ModelSymmetryError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    if files.iter().any(|(known, _)| known.eq_ignore_ascii_case(&name)) {
        return Ok(());
    }
    let content =
        fs::read(path).map_err(|source| ModelSymmetryError::Read { path: path.into(), source })?;
    files.push((name, content.clone()));
    let is_xml = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("xml"));
    if !is_xml {
        return Ok(());
    }
    let invalid = |message| ModelSymmetryError::InvalidFile { path: path.into(), message };
    let text = String::from_utf8(content).map_err(|error| invalid(error.to_string()))?;
    let document = roxmltree::Document::parse(&text).map_err(|error| invalid(error.to_string()))?;
    let attributes = || document.descendants().flat_map(|node| node.attributes());
    let folders = attributes().filter(|attribute| attribute.name().ends_with("dir"));
    let folders: Vec<PathBuf> = [root.to_owned()]
        .into_iter()
        .chain(folders.map(|folder| root.join(folder.value())))
        .collect();
    for named in attributes().filter(|attribute| attribute.name().starts_with("file")) {
        let places = folders.iter().map(|folder| folder.join(named.value()));
        // MuJoCo reports a file that is missing
        if let Some(place) = places.into_iter().find(|place| place.is_file()) {
            add_file(&place, root, files)?;
        }
    }
    Ok(())
}
