//! Collision shapes from mesh files: the convex hull of the points of a mesh.

use std::path::{Path, PathBuf};

use glam::DVec3;

use super::collada;
use super::xml::{MAX_URDF_BYTES, decode, parse};
use super::{Report, UrdfSettings, read};
use crate::capsule::PlacedShape;
use crate::error::{DescriptionError, MAX_NUMBER};
use crate::hull::mesh_shape;

/// Maximum size of a mesh file (bytes).
const MAX_BYTES: usize = 64 << 20;
/// Number of folders that are searched for packages: the URDF's own and those above it.
const SEARCHED: usize = 6;

/// Reader of the mesh files that a URDF names.
pub(super) struct Meshes<'a> {
    settings: &'a UrdfSettings,
    /// The URDF's folder and those above it, nearest first, without symbolic links. Empty for a
    /// URDF that is no file.
    folders: Vec<PathBuf>,
    /// Folders that no mesh may lie outside of: the root, and the packages of the settings.
    allowed: Vec<PathBuf>,
}

impl<'a> Meshes<'a> {
    /// Creates a reader of the meshes of a URDF in `folder`, which is `None` for a URDF that is no
    /// file.
    ///
    /// # Errors
    /// [`DescriptionError::InvalidFolder`] for a folder of the settings that does not exist.
    pub(super) fn new(
        settings: &'a UrdfSettings,
        folder: Option<&Path>,
    ) -> Result<Self, DescriptionError> {
        let real = |setting: String, stated: &PathBuf| {
            let found = stated.canonicalize().ok().filter(|found| found.is_dir());
            found.ok_or(DescriptionError::InvalidFolder { setting, folder: stated.clone() })
        };
        let packages = settings.packages.iter();
        let packages = packages
            .map(|(name, stated)| real(format!("UrdfSettings::packages[\"{name}\"]"), stated));
        let mut allowed: Vec<PathBuf> = packages.collect::<Result<_, _>>()?;
        let root = settings.mesh_root.as_ref();
        let root = root.map(|root| real("UrdfSettings::mesh_root".to_owned(), root)).transpose()?;
        let own = folder.and_then(|folder| folder.canonicalize().ok());
        let above = own.iter().flat_map(|own| own.ancestors().skip(1).take(SEARCHED - 1));
        // `/` is no folder of packages
        let above = above.filter(|path| path.parent().is_some());
        let within = |path: &&Path| root.as_ref().is_none_or(|root| path.starts_with(root));
        let folders = own.as_deref().into_iter().chain(above.filter(within));
        let folders: Vec<PathBuf> = folders.map(Path::to_owned).collect();
        allowed.extend(root.or_else(|| folders.last().cloned()));
        Ok(Self { settings, folders, allowed })
    }

    /// Returns the convex hull of the points of a mesh, or a capsule if it is flat. `None` if
    /// meshes are ignored, and for a mesh without points or one that cannot be read, which is
    /// reported.
    pub(super) fn shape(
        &self,
        link: &str,
        line: usize,
        file: &str,
        scale: DVec3,
        report: &mut Report,
    ) -> Option<PlacedShape> {
        let place = format!("the link `{link}` collides as the mesh `{file}`, which");
        if self.settings.ignore_meshes {
            report.note(
                line,
                &format!("{place} is ignored, so this shape neither touches nor hides"),
            );
            return None;
        }
        let file = file.replace('\\', "/");
        let path = self.find(&file, report);
        // the user says where such a package is, so that must not be overlooked
        if let (Err(reason), true) = (&path, self.is_mapped(&file)) {
            let problem = format!("cannot be used: {reason}");
            report.reject(line, DescriptionError::InvalidElement { place, problem });
            return None;
        }
        let points = path.and_then(|path| {
            let points = scaled_points(&path, scale, report);
            points.map_err(|reason| format!("`{}`: {reason}", path.display()))
        });
        match points {
            Ok(points) if !points.is_empty() => return Some(mesh_shape(&points)),
            Ok(_) => report.note(line, &format!("{place} holds no points; it is left out")),
            Err(reason) => {
                let missing = format!("line {line}: {place} cannot be used: {reason}");
                report.missing_shapes.push(missing);
            }
        }
        None
    }

    /// Returns `true` if a file is in a package of the settings.
    fn is_mapped(&self, file: &str) -> bool {
        package(file).is_some_and(|(name, _)| self.settings.packages.contains_key(name))
    }

    /// Finds the file that a URDF names. The error lists the paths that were tried.
    fn find(&self, file: &str, report: &mut Report) -> Result<PathBuf, String> {
        let Some(own) = self.folders.first() else {
            return Err("the URDF was read without its folder; use `from_urdf_file`".to_owned());
        };
        let (tried, known) = match (package(file), file.split_once("://")) {
            (Some((name, path)), _) => {
                let (roots, known) = self.roots(name);
                (roots.iter().map(|root| root.join(path)).collect(), known)
            }
            (None, None) => (vec![own.join(file)], 1),
            (None, Some(("file", path))) => (vec![own.join(path)], 1),
            (None, Some((scheme, _))) => {
                let read = "only package://, model:// and file://";
                return Err(format!("`{scheme}://` is not read, {read}"));
            }
        };
        let real = |path: &PathBuf| path.canonicalize().ok().filter(|real| real.is_file());
        let mut existing = tried.iter().map(real).enumerate();
        let found = existing.find_map(|(index, path)| Some((index, path?)));
        let Some((index, found)) = found else {
            let paths: Vec<String> =
                tried.iter().map(|path| format!("`{}`", path.display())).collect();
            let advice = match package(file) {
                Some(_) => "give the right folder of its package in `packages` of the settings",
                None => "correct its `filename`",
            };
            return Err(format!("no such file, tried {}; {advice}", paths.join(", ")));
        };
        if !self.allowed.iter().any(|folder| found.starts_with(folder)) {
            let root = self.allowed.last().unwrap_or(own).display();
            return Err(format!(
                "`{}` is outside of `{root}`, and no file there is read; give a folder around both \
                 as `mesh_root` of the settings",
                found.display()
            ));
        }
        if let (true, Some((name, _))) = (index >= known, package(file)) {
            let note = format!(
                "no folder of the package `{name}` has all its meshes, so some are read from other \
                 folders around the URDF; give its folder in `packages` of the settings"
            );
            report.note(0, &note);
        }
        Ok(found)
    }

    /// Returns the folders that may be the root of a package, the most likely one first, and the
    /// number of them that are no guesses.
    ///
    /// A folder of the settings is the only one. Else come folders that have the package's name,
    /// and those whose `package.xml` has it. A copied package often has another name, so each other
    /// folder around the URDF may be it, unless it is another package.
    fn roots(&self, name: &str) -> (Vec<PathBuf>, usize) {
        if let Some(folder) = self.settings.packages.get(name) {
            return (vec![folder.clone()], 1);
        }
        let mut roots: Vec<PathBuf> = self.folders.iter().map(|near| near.join(name)).collect();
        let others = self.folders.iter().filter(|near| !roots.contains(near));
        let others: Vec<_> = others.map(|near| (near, package_name(near))).collect();
        let with = |stated: Option<&str>| {
            let same = others.iter().filter(move |(_, of)| of.as_deref() == stated);
            same.map(|(near, _)| (*near).clone()).collect::<Vec<_>>()
        };
        roots.extend(with(Some(name)));
        let known = roots.len();
        roots.extend(with(None));
        (roots, known)
    }
}

/// Returns the package that a file name starts with, and the path in it.
fn package(file: &str) -> Option<(&str, &str)> {
    let path = file.strip_prefix("package://").or_else(|| file.strip_prefix("model://"))?;
    Some(path.split_once('/').unwrap_or((path, "")))
}

/// Returns the name of the ROS package whose root is `folder`; `None` if it is none.
fn package_name(folder: &Path) -> Option<String> {
    let text = decode(read(&folder.join("package.xml"), MAX_URDF_BYTES).ok()?);
    let name = |package: roxmltree::Node| {
        let name = package.children().find(|child| child.has_tag_name("name"))?;
        Some(name.text()?.trim().to_owned())
    };
    parse(&text, "package", name).ok()?
}

/// Reads all points of a mesh (metres).
fn scaled_points(path: &Path, scale: DVec3, report: &mut Report) -> Result<Vec<DVec3>, String> {
    let bytes = read(path, MAX_BYTES).map_err(|error| error.to_string())?;
    let mut points = points(path, bytes, report)?;
    for point in &mut points {
        *point *= scale;
        // a comparison that is false for NaN, too
        if !point.abs().cmple(DVec3::splat(MAX_NUMBER)).all() {
            return Err(format!("its point {point}, as scaled, is not within 1e6 m of zero"));
        }
    }
    Ok(points)
}

/// Returns all points of a mesh, with repetitions.
fn points(path: &Path, bytes: Vec<u8>, report: &mut Report) -> Result<Vec<DVec3>, String> {
    if bytes.len() > MAX_BYTES {
        return Err("it has more than 64 MB".to_owned());
    }
    let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
    match extension.to_str() {
        // binary STL may start with `solid`, too, but its number of triangles has a zero byte
        Some("stl") if bytes.contains(&0) => binary_stl(&bytes),
        Some("stl") => vertices(&decode(bytes), "vertex"),
        Some("obj") => vertices(&decode(bytes), "v"),
        Some("dae") => {
            let (points, note) = collada::points(&decode(bytes))?;
            note.into_iter().for_each(|note| report.note(0, note));
            Ok(points)
        }
        _ => Err("only STL, OBJ and DAE (COLLADA) files are read".to_owned()),
    }
}

/// Parses a binary STL: 80 bytes, the number of triangles, and for each a normal, three points and
/// two bytes. Some files lack the number, or have it wrong, so the length may decide.
fn binary_stl(bytes: &[u8]) -> Result<Vec<DVec3>, String> {
    let (triangles, rest) = bytes.get(84..).unwrap_or_default().as_chunks::<50>();
    let stated = bytes.get(80..84).and_then(|count| count.try_into().ok());
    let stated = stated.map_or(0, |count| u32::from_le_bytes(count) as usize);
    let count = if rest.is_empty() { triangles.len() } else { stated };
    if bytes.len() < 80 || count > triangles.len() || (count == 0 && !rest.is_empty()) {
        return Err(format!("as binary STL, {} bytes do not hold {stated} triangles", bytes.len()));
    }
    let number = |word: &[u8; 4]| f64::from(f32::from_le_bytes(*word));
    let corners = triangles[..count].iter();
    let corners = corners.flat_map(|triangle| triangle[12..48].as_chunks::<12>().0);
    let point = |corner: &[u8; 12]| {
        let [x, y, z] = [0, 1, 2].map(|axis| number(&corner.as_chunks::<4>().0[axis]));
        DVec3::new(x, y, z)
    };
    Ok(corners.map(point).collect())
}

/// Parses the points of a text, three numbers on each line that starts with `word`.
fn vertices(text: &str, word: &str) -> Result<Vec<DVec3>, String> {
    let mut points = Vec::new();
    for line in text.lines() {
        let mut words = line.split_whitespace();
        if !words.next().is_some_and(|first| first.eq_ignore_ascii_case(word)) {
            continue;
        }
        let mut number = || words.next()?.parse().ok();
        let point = number().zip(number()).zip(number());
        let ((x, y), z) = point.ok_or("a point of it has fewer than three numbers")?;
        points.push(DVec3::new(x, y, z));
    }
    if points.is_empty() {
        let is_pointer = text.starts_with("version https://git-lfs");
        let hint = if is_pointer { "; it is a pointer of Git LFS: run `git lfs pull`" } else { "" };
        return Err(format!("no line of it starts with `{word}`{hint}"));
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
        let mut padded = binary.clone();
        padded[80..84].copy_from_slice(&1_u32.to_le_bytes());
        padded.extend([7; 3]);
        for (name, bytes) in [
            ("a.STL", binary),
            ("a.stl", padded),
            ("a.stl", text.to_uppercase().into_bytes()),
            ("a.stl", text.into_bytes()),
            ("a.obj", object.into_bytes()),
        ] {
            let found = points(Path::new(name), bytes, &mut Report::default());
            assert_eq!(found.unwrap(), expected, "{name}");
        }
        for empty in [80, 84] {
            let found = points(Path::new("a.stl"), vec![0; empty], &mut Report::default());
            assert_eq!(found.unwrap(), []);
        }
    }

    #[test]
    fn files_that_are_no_meshes_are_refused() {
        for (name, bytes, words) in [
            ("a.ply", "v 1 2 3", "only STL"),
            ("a.obj", "v 1 2", "fewer than three"),
            ("a.obj", "v 1 2 x", "fewer than three"),
            ("a.stl", "solid", "no line of it starts with `vertex`"),
            ("a.obj", "<html>", "no line of it starts with `v`"),
            ("a.obj", "version https://git-lfs.github.com/spec/v1", "run `git lfs pull`"),
            ("a.dae", "v 1 2 3", "COLLADA"),
        ] {
            let found = points(Path::new(name), bytes.into(), &mut Report::default());
            let error = found.unwrap_err();
            assert!(error.contains(words), "{error}");
        }
        // two triangles, of which one is cut off
        let mut cut = vec![0; 84 + 50 + 49];
        for (stated, words) in [(2, "183 bytes do not hold 2 triangles"), (0, "do not hold 0")] {
            cut[80] = stated;
            let error = points(Path::new("a.stl"), cut.clone(), &mut Report::default());
            assert!(error.unwrap_err().contains(words));
        }
    }
}
