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
    let root = path.parent().unwrap_or(Path::new(""));
    add_file(path, root, &[root.to_owned()], &mut files)?;
    let files: Vec<(&str, &[u8])> =
        files.iter().map(|(name, content)| (&name[..], &content[..])).collect();
    Ok(Model::from_files(files[0].0, &files)?)
}

/// Adds a file, and if it is XML, the files that it names, each by its plain name. They are looked
/// for in `folders` and in those that the file names, as MuJoCo does: files of XML in the model's
/// folder first, and others in the named folders first.
///
/// MuJoCo finds files by their plain names here, so two different files of one name are refused.
fn add_file(
    path: &Path,
    root: &Path,
    folders: &[PathBuf],
    files: &mut Vec<(String, Vec<u8>)>,
) -> Result<(), ModelSymmetryError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let content =
        fs::read(path).map_err(|source| ModelSymmetryError::Read { path: path.into(), source })?;
    let invalid = |message| ModelSymmetryError::InvalidFile { path: path.into(), message };
    if let Some((_, known)) = files.iter().find(|(known, _)| known.eq_ignore_ascii_case(&name)) {
        if *known == content {
            return Ok(());
        }
        return Err(invalid("the model names another file of this name, too: rename one".into()));
    }
    files.push((name, content.clone()));
    if !is_xml_name(path) {
        return Ok(());
    }
    let text = String::from_utf8(content).map_err(|error| invalid(error.to_string()))?;
    let document = roxmltree::Document::parse(&text).map_err(|error| invalid(error.to_string()))?;
    let attributes = || document.descendants().flat_map(|node| node.attributes());
    // what a file names holds for the files that it includes, too
    let own = attributes().filter(|attribute| attribute.name().ends_with("dir"));
    let own = own.map(|folder| root.join(folder.value()));
    let all: Vec<PathBuf> = folders.iter().cloned().chain(own).collect();
    for named in attributes().filter(|attribute| attribute.name().starts_with("file")) {
        let mut places: Vec<PathBuf> =
            all.iter().map(|folder| folder.join(named.value())).collect();
        if !is_xml_name(Path::new(named.value())) {
            places.reverse();
        }
        // MuJoCo reports a file that is missing
        if let Some(place) = places.into_iter().find(|place| place.is_file()) {
            add_file(&place, root, &all, files)?;
        }
    }
    Ok(())
}

fn is_xml_name(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("xml"))
}
