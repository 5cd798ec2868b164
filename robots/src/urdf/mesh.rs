//! Collision shapes from mesh files: a capsule that encloses the points of a mesh.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};

use glam::DVec3;

use crate::capsule::PlacedShape;
use crate::error::DescriptionError;
use crate::error::MAX_NUMBER;
use crate::fit::bounding_capsule;

/// Maximum size of a mesh file (bytes).
const MAX_BYTES: u64 = 64 << 20;

/// Reads the mesh `file`, which lies in `folder` or below, and returns a capsule that encloses its
/// points.
pub(super) fn capsule(
    link: &str,
    file: &str,
    scale: DVec3,
    folder: Option<&Path>,
) -> Result<PlacedShape, DescriptionError> {
    let refused = |reason: String| DescriptionError::InvalidMesh {
        link: link.to_owned(),
        file: file.to_owned(),
        reason,
    };
    check_inside(link, file)?;
    let folder =
        folder.ok_or_else(|| refused("the URDF was given without its folder".to_owned()))?;
    let path = real_path(folder, file).map_err(|error| refused(error.to_string()))?;
    let path = path.ok_or_else(|| outside(link, file))?;
    let bytes = read(&path).map_err(|error| refused(error.to_string()))?;
    let points = points(&path, &bytes).map_err(|reason| refused(reason.to_owned()))?;
    let points: Vec<DVec3> = points.into_iter().map(|point| scale * point).collect();
    let sound = |point: &DVec3| point.abs().max_element() <= MAX_NUMBER;
    if points.is_empty() || !points.iter().all(sound) {
        return Err(refused("it holds no points, or points beyond 1e6 m".to_owned()));
    }
    Ok(bounding_capsule(&points))
}

/// Rejects the name of a file outside of the URDF's folder.
pub(super) fn check_inside(link: &str, file: &str) -> Result<(), DescriptionError> {
    let path = relative(file);
    let plain = |part: Component<'_>| matches!(part, Component::Normal(_) | Component::CurDir);
    let parts = Path::new(path).components().all(plain);
    if parts && !path.contains("://") && !path.contains('\\') {
        return Ok(());
    }
    Err(outside(link, file))
}

fn outside(link: &str, file: &str) -> DescriptionError {
    DescriptionError::MeshOutsideFolder { link: link.to_owned(), file: file.to_owned() }
}

/// Returns the path in the URDF's folder that `file` refers to. ROS's `package://NAME/` stands for
/// that folder.
fn relative(file: &str) -> &str {
    let in_package = file.strip_prefix("package://").map(|rest| match rest.split_once('/') {
        Some((package, path)) if ![".", "..", ""].contains(&package) => path,
        // a path that is rejected
        _ => "..",
    });
    in_package.unwrap_or(file)
}

/// Returns the file's path with symbolic links resolved. `None` if it lies outside of the folder.
fn real_path(folder: &Path, file: &str) -> io::Result<Option<PathBuf>> {
    let folder = folder.canonicalize()?;
    let path = folder.join(relative(file)).canonicalize()?;
    Ok(path.starts_with(&folder).then_some(path))
}

fn read(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(MAX_BYTES + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Returns all points of a mesh, with repetitions.
fn points(path: &Path, bytes: &[u8]) -> Result<Vec<DVec3>, &'static str> {
    if bytes.len() as u64 > MAX_BYTES {
        return Err("it has more than 64 MB");
    }
    let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
    let text = || std::str::from_utf8(bytes).map_err(|_| "it is neither binary STL nor text");
    match extension.to_str() {
        // a binary STL may start with `solid`, too, so the length decides
        Some("stl") => binary_stl(bytes).map_or_else(|| named(text()?, "vertex"), Ok),
        Some("obj") => named(text()?, "v"),
        _ => Err("only STL and OBJ files are read"),
    }
}

/// Parses a binary STL: 80 bytes, the number of triangles, and for each a normal, three points and
/// two bytes. `None` if the length does not match the number of triangles.
fn binary_stl(bytes: &[u8]) -> Option<Vec<DVec3>> {
    let (head, triangles) = bytes.split_at_checked(84)?;
    let count = u32::from_le_bytes(head[80..].try_into().ok()?) as usize;
    let (triangles, rest) = triangles.as_chunks::<50>();
    if triangles.len() != count || !rest.is_empty() {
        return None;
    }
    let number = |word: &[u8; 4]| f64::from(f32::from_le_bytes(*word));
    let corners = triangles.iter().flat_map(|triangle| triangle[12..48].as_chunks::<12>().0);
    let point = |corner: &[u8; 12]| {
        let [x, y, z] = [0, 1, 2].map(|axis| number(&corner.as_chunks::<4>().0[axis]));
        DVec3::new(x, y, z)
    };
    Some(corners.map(point).collect())
}

/// Parses the points of a text, three numbers on each line that starts with `word`.
fn named(text: &str, word: &str) -> Result<Vec<DVec3>, &'static str> {
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
    fn files_outside_of_the_folder_are_told_from_those_inside() {
        for inside in ["a.stl", "meshes/a.stl", "./a.stl", "package://arm/meshes/a.stl"] {
            assert!(check_inside("l", inside).is_ok(), "{inside}");
        }
        for outside in [
            "/etc/passwd",
            "../a.stl",
            "meshes/../../a.stl",
            "file:///etc/passwd",
            "https://host/a.stl",
            "package://../a.stl",
            "package://arm/../a.stl",
            "package:///etc/passwd",
            "package://arm",
            "..\\a.stl",
        ] {
            assert!(check_inside("l", outside).is_err(), "{outside}");
        }
    }

    /// A binary STL of these triangles.
    fn stl(triangles: &[[[f32; 3]; 3]]) -> Vec<u8> {
        let mut bytes = vec![b's'; 80];
        bytes.extend((triangles.len() as u32).to_le_bytes());
        for triangle in triangles {
            bytes.extend([0; 12]);
            let numbers = triangle.as_flattened().iter();
            bytes.extend(numbers.flat_map(|number| number.to_le_bytes()));
            bytes.extend([0; 2]);
        }
        bytes
    }

    #[test]
    fn points_are_read_from_three_kinds_of_files() {
        let corners = [[1.0, 2.0, 3.0], [-4.0, 0.5, 0.0], [0.0, 0.0, 8.0]];
        let expected = corners.map(|corner| glam::Vec3::from_array(corner).as_dvec3());
        let lines = |word: &str| {
            let line = |[x, y, z]: [f32; 3]| format!("  {word} {x} {y} {z}\n");
            corners.map(line).concat()
        };
        let text = format!("solid\n facet normal 0 0 1\n{}endsolid", lines("vertex"));
        let object = format!("# v 9 9 9\nvn 0 0 1\n{}f 1 2 3\n", lines("v"));
        for (name, bytes) in [
            ("a.STL", stl(&[corners])),
            ("a.stl", text.into_bytes()),
            ("a.obj", object.into_bytes()),
        ] {
            assert_eq!(points(Path::new(name), &bytes).unwrap(), expected, "{name}");
        }
    }

    #[test]
    fn files_that_are_no_meshes_are_refused() {
        let refused = |name: &str, bytes: &[u8]| points(Path::new(name), bytes).unwrap_err();
        assert!(refused("a.dae", b"v 1 2 3").contains("only STL"));
        assert!(refused("a.obj", b"v 1 2").contains("fewer than three"));
        assert!(refused("a.obj", b"v 1 2 x").contains("fewer than three"));
        let mut cut = stl(&[[[1.0; 3]; 3]]);
        cut.pop();
        cut[3] = 0xff;
        assert!(refused("a.stl", &cut).contains("neither binary"));
    }
}
