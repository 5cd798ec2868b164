//! Collision shapes from mesh files: a capsule that encloses the points of a mesh.

use std::path::{Path, PathBuf};

use glam::DVec3;

use super::collada;
use super::xml::decode;
use super::{Report, UrdfSettings, read};
use crate::capsule::PlacedShape;
use crate::error::MAX_NUMBER;
use crate::fit::bounding_capsule;

/// Maximum size of a mesh file (bytes).
const MAX_BYTES: usize = 64 << 20;
/// Number of folders that are searched for packages: the URDF's own and those above it.
const SEARCHED: usize = 6;

/// Reader of the meshes that a URDF names.
pub(super) struct Meshes<'a> {
    settings: &'a UrdfSettings,
    /// The URDF's folder and those above it, nearest first, without symbolic links. Empty for a
    /// URDF that is no file.
    folders: Vec<PathBuf>,
    /// Folder that no mesh may lie outside of, unless a package of the settings holds it.
    root: PathBuf,
}

impl<'a> Meshes<'a> {
    pub(super) fn new(settings: &'a UrdfSettings, folder: Option<&Path>) -> Self {
        let real = |path: &Path| path.canonicalize().ok();
        let own = folder.and_then(real).unwrap_or_default();
        let limit = settings.mesh_root.as_deref().and_then(real);
        let above = own.ancestors().filter(|path| path.parent().is_some()).take(SEARCHED);
        let within = |path: &Path| limit.as_ref().is_none_or(|root| path.starts_with(root));
        let folders = above.filter(|&path| path == own || within(path));
        let folders: Vec<PathBuf> = folders.map(Path::to_owned).collect();
        let root = limit.or_else(|| folders.last().cloned()).unwrap_or_default();
        Self { settings, folders, root }
    }

    /// Returns a capsule that encloses the points of a mesh. `None` if meshes are ignored, and for
    /// a mesh without points or one that cannot be read, which is reported.
    pub(super) fn shape(
        &self,
        link: &str,
        line: usize,
        file: &str,
        scale: DVec3,
        report: &mut Report,
    ) -> Option<PlacedShape> {
        if self.settings.ignore_meshes {
            return None;
        }
        match self.points(file) {
            Ok(points) if !points.is_empty() => {
                let points: Vec<DVec3> = points.into_iter().map(|point| scale * point).collect();
                return Some(bounding_capsule(&points));
            }
            Ok(_) => report.note(line, &format!("the mesh `{file}` of `{link}` holds no points")),
            Err(reason) => report.unread_meshes.push(format!(
                "line {line}: the link `{link}` collides as the mesh `{file}`, which cannot be \
                 used: {reason}"
            )),
        }
        None
    }

    fn points(&self, file: &str) -> Result<Vec<DVec3>, String> {
        let path = self.find(file)?;
        let bytes = read(&path, MAX_BYTES).map_err(|error| error.to_string());
        let points = bytes.and_then(|bytes| points(&path, bytes));
        let is_near = |point: &DVec3| point.abs().max_element() <= MAX_NUMBER;
        let points = points.and_then(|points| {
            let all = points.iter().all(is_near);
            if all { Ok(points) } else { Err("it holds points beyond 1e6".to_owned()) }
        });
        points.map_err(|reason| format!("`{}`: {reason}", path.display()))
    }

    /// Finds the file that a URDF names. The error lists the paths that were tried.
    fn find(&self, file: &str) -> Result<PathBuf, String> {
        if self.folders.is_empty() {
            return Err("the URDF was read without its folder; use `from_urdf_file`".to_owned());
        }
        let tried = self.candidates(&file.replace('\\', "/"))?;
        let mut outside = String::new();
        for path in tried.iter().filter_map(|path| path.canonicalize().ok()) {
            let mut packages = self.settings.packages.iter().map(|(_, folder)| folder.as_path());
            let inside = |folder: &Path| folder.canonicalize().is_ok_and(|f| path.starts_with(f));
            if path.is_file() && (inside(&self.root) || packages.any(inside)) {
                return Ok(path);
            }
            outside = format!("; no file outside of `{}` is read", self.root.display());
        }
        let tried: Vec<String> = tried.iter().map(|path| format!("`{}`", path.display())).collect();
        Err(format!(
            "no such file, tried {}{outside}; give the folder of its package in \
             `UrdfSettings::packages`, or the folder around all files as `UrdfSettings::mesh_root`",
            tried.join(", ")
        ))
    }

    /// Returns the paths at which a file may lie, the most likely one first.
    fn candidates(&self, file: &str) -> Result<Vec<PathBuf>, String> {
        let (scheme, path) = file.split_once("://").unwrap_or(("", file));
        match scheme {
            "" | "file" => Ok(vec![self.folders[0].join(path)]),
            "package" | "model" => {
                let (name, path) = path.split_once('/').unwrap_or(("", path));
                let given = self.settings.packages.iter().find(|(given, _)| given == name);
                // a package's folder may have another name than the package
                let near = self.folders.iter().flat_map(|near| [near.join(name), near.clone()]);
                let folders =
                    given.map_or_else(|| near.collect(), |(_, given)| vec![given.clone()]);
                Ok(folders.into_iter().map(|folder| folder.join(path)).collect())
            }
            other => {
                Err(format!("`{other}://` is not read, only package://, model:// and file://"))
            }
        }
    }
}

/// Returns all points of a mesh, with repetitions.
fn points(path: &Path, bytes: Vec<u8>) -> Result<Vec<DVec3>, String> {
    if bytes.len() > MAX_BYTES {
        return Err("it has more than 64 MB".to_owned());
    }
    let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
    match extension.to_str() {
        // a binary STL may start with `solid`, too
        Some("stl") => match std::str::from_utf8(&bytes) {
            Ok(text) if text.contains("vertex") => named(text, "vertex"),
            _ => binary_stl(&bytes),
        },
        Some("obj") => named(&decode(bytes), "v"),
        Some("dae") => collada::points(&decode(bytes)),
        _ => Err("only STL, OBJ and DAE (COLLADA) files are read".to_owned()),
    }
}

/// Parses a binary STL: 80 bytes, the number of triangles, and for each a normal, three points and
/// two bytes. The number is wrong in many files, so the length decides.
fn binary_stl(bytes: &[u8]) -> Result<Vec<DVec3>, String> {
    let triangles = bytes.get(84..).unwrap_or_default().as_chunks::<50>().0;
    if triangles.is_empty() && ![80, 84].contains(&bytes.len()) {
        return Err("it is neither a text with `vertex` nor binary STL".to_owned());
    }
    let number = |word: &[u8; 4]| f64::from(f32::from_le_bytes(*word));
    let corners = triangles.iter().flat_map(|triangle| triangle[12..48].as_chunks::<12>().0);
    let point = |corner: &[u8; 12]| {
        let [x, y, z] = [0, 1, 2].map(|axis| number(&corner.as_chunks::<4>().0[axis]));
        DVec3::new(x, y, z)
    };
    Ok(corners.map(point).collect())
}

/// Parses the points of a text, three numbers on each line that starts with `word`.
fn named(text: &str, word: &str) -> Result<Vec<DVec3>, String> {
    let mut points = Vec::new();
    for line in text.lines() {
        let mut words = line.split_whitespace();
        if words.next() != Some(word) {
            continue;
        }
        let mut number = || words.next()?.parse().ok();
        let point = number().zip(number()).zip(number());
        let ((x, y), z) = point.ok_or("a point of it has fewer than three numbers")?;
        points.push(DVec3::new(x, y, z));
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_read_from_three_kinds_of_files() {
        let corners: [[f32; 3]; 3] = [[1.0, 2.0, 3.0], [-4.0, 0.5, 0.0], [0.0, 0.0, 8.0]];
        let expected = corners.map(|corner| glam::Vec3::from_array(corner).as_dvec3());
        let named =
            |word: &str| corners.map(|[x, y, z]| format!("  {word} {x} {y} {z}\n")).concat();
        let text = format!("solid\n facet normal 0 0 1\n{}endsolid", named("vertex"));
        let object = format!("# v 9 9 9\nvn 0 0 1\n{}f 1 2 3\n", named("v"));
        // a head with a wrong number of triangles, a normal, three corners, and two bytes
        let mut binary = vec![7; 84 + 12];
        binary.extend(corners.as_flattened().iter().flat_map(|number| number.to_le_bytes()));
        binary.extend([0; 2]);
        for (name, bytes) in
            [("a.STL", binary), ("a.stl", text.into_bytes()), ("a.obj", object.into_bytes())]
        {
            assert_eq!(points(Path::new(name), bytes).unwrap(), expected, "{name}");
        }
        for empty in [80, 84] {
            assert_eq!(points(Path::new("a.stl"), vec![0; empty]).unwrap(), []);
        }
    }

    #[test]
    fn files_that_are_no_meshes_are_refused() {
        for (name, bytes, words) in [
            ("a.ply", "v 1 2 3", "only STL"),
            ("a.obj", "v 1 2", "fewer than three"),
            ("a.obj", "v 1 2 x", "fewer than three"),
            ("a.stl", "solid", "neither a text"),
            ("a.dae", "v 1 2 3", "COLLADA"),
        ] {
            let error = points(Path::new(name), bytes.into()).unwrap_err();
            assert!(error.contains(words), "{error}");
        }
    }
}
