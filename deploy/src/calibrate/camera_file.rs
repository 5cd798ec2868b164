//! Intrinsics and lens of a camera from YAML: OpenCV's `FileStorage`, and ROS' `camera_info` as a
//! file or as a printed message.

use std::path::Path;

use experiments::RunError;
use inpainting::{Intrinsics, LensDistortion};
use saphyr_parser::{Event, Parser, ScalarStyle, StrInput};
use serde_json::{Map, Number, Value};

/// Maximum size of a camera file (bytes): OpenCV writes all corners of a chessboard into it.
const MAX_BYTES: u64 = 4 << 20;
/// Maximum nesting depth of mappings and lists in a camera file; cameras need three.
const MAX_DEPTH: usize = 16;
/// Distance (pixels) from the middle of the first pixel, the origin of OpenCV and ROS, to its
/// corner, the origin of [`Intrinsics::principal_point`].
const CORNER: f64 = 0.5;
/// Names of the picture's width in OpenCV's and ROS' files, in lower case and without underscores.
const WIDTH: &[&str] = &["imagewidth", "width"];
const HEIGHT: &[&str] = &["imageheight", "height"];
const MATRIX: &[&str] = &["cameramatrix", "k", "mtx", "intrinsicmatrix"];
const LENS: &[&str] = &["distortioncoefficients", "distcoeffs", "distcoeff", "dist", "d"];

/// Reads a camera's intrinsics and lens distortion from a YAML file of OpenCV or ROS.
///
/// # Errors
/// [`RunError::Read`] with the file and the reason.
pub(super) fn read_camera_intrinsics(
    path: &Path,
) -> Result<(Intrinsics, LensDistortion), RunError> {
    let metadata = std::fs::metadata(path).map_err(RunError::read_error_mapper(path))?;
    let size = metadata.len();
    // a pipe or a device might never end
    if !metadata.is_file() || size > MAX_BYTES {
        let problem = format!("it has {size} bytes, expected a plain file of at most 4 MiB");
        return Err(RunError::damaged_file(path, problem));
    }
    let text = std::fs::read_to_string(path).map_err(RunError::read_error_mapper(path))?;
    parse(&text).map_err(|problem| RunError::damaged_file(path, problem))
}

fn parse(text: &str) -> Result<(Intrinsics, LensDistortion), String> {
    // `%YAML:1.0`, which OpenCV writes, is no directive of YAML
    let lines = text.trim_start_matches('\u{feff}').lines();
    let lines: Vec<&str> = lines.filter(|line| !line.starts_with("%YAML")).collect();
    let tree =
        tree(&lines.join("\n")).map_err(|error| format!("it is no YAML of a camera: {error}"))?;
    let model = find(&tree, &["distortionmodel"]).and_then(Value::as_str).unwrap_or_default();
    let fisheye = find(&tree, &["fisheyemodel"]).is_some_and(|of| *of != 0 && *of != "false");
    if fisheye || !matches!(model, "" | "plumb_bob" | "rational_polynomial") {
        return Err(format!(
            "its distortion model is `{}`, expected plumb_bob or rational_polynomial: rectify the \
             pictures, or calibrate the camera with one of these",
            if fisheye { "fisheye" } else { model }
        ));
    }
    let matrix = numbers(&tree, MATRIX)?;
    let [fx, skew, cx, a, fy, cy, b, c, one] = matrix[..] else {
        return Err(format!("its camera matrix has {} numbers, expected 3 x 3", matrix.len()));
    };
    if [skew, a, b, c, one] != [0.0, 0.0, 0.0, 0.0, 1.0] {
        return Err(format!(
            "its camera matrix is {matrix:?}, expected [fx, 0, cx, 0, fy, cy, 0, 0, 1], without skew"
        ));
    }
    let [width, height] = [whole(&tree, WIDTH)?, whole(&tree, HEIGHT)?];
    let intrinsics = Intrinsics {
        width,
        height,
        focal_lengths: [fx, fy],
        principal_point: [cx + CORNER, cy + CORNER],
    };
    let lens =
        LensDistortion::from_opencv(&numbers(&tree, LENS)?).map_err(|error| error.to_string())?;
    Ok((intrinsics, lens))
}

/// Parses the first document of a YAML text to a JSON value. Tags have no meaning.
fn tree(text: &str) -> Result<Value, String> {
    let mut parser = Parser::new_from_str(text);
    loop {
        match next(&mut parser)? {
            Event::StreamStart | Event::DocumentStart(_) | Event::Nothing => {}
            event => return node(event, &mut parser, MAX_DEPTH),
        }
    }
}

fn next<'a>(parser: &mut Parser<'a, StrInput<'a>>) -> Result<Event<'a>, String> {
    match parser.next() {
        Some(Ok((event, _))) => Ok(event),
        Some(Err(error)) => Err(error.to_string()),
        None => Err("it ends too early".to_owned()),
    }
}

/// Parses the YAML value that begins with the parser's `event`.
fn node<'a>(
    event: Event<'a>,
    parser: &mut Parser<'a, StrInput<'a>>,
    depth: usize,
) -> Result<Value, String> {
    let deeper = || depth.checked_sub(1).ok_or_else(|| format!("more than {MAX_DEPTH} levels"));
    match event {
        Event::Scalar(text, ScalarStyle::Plain, ..) => Ok(plain(&text)),
        Event::Scalar(text, ..) => Ok(text.into()),
        Event::SequenceStart(..) => {
            let mut list = Vec::new();
            loop {
                match next(parser)? {
                    Event::SequenceEnd => return Ok(list.into()),
                    item => list.push(node(item, parser, deeper()?)?),
                }
            }
        }
        Event::MappingStart(..) => {
            let mut map = Map::new();
            loop {
                let key = match next(parser)? {
                    Event::MappingEnd => return Ok(map.into()),
                    Event::Scalar(key, ..) => key,
                    _ => return Err("expected a name before each value of a mapping".to_owned()),
                };
                let value = next(parser)?;
                if map.insert(key.to_string(), node(value, parser, deeper()?)?).is_some() {
                    return Err(format!("`{key}` is there twice"));
                }
            }
        }
        // an alias could make a short file a large one
        Event::Alias(_) => {
            Err("it has an alias (`*name`): write the value in its place".to_owned())
        }
        _ => Err("a value is missing".to_owned()),
    }
}

/// Returns the value of a YAML scalar without quotes: a number if it is one, else a text.
fn plain(text: &str) -> Value {
    let whole = text.parse::<u64>().ok().map(Number::from);
    let number = whole.or_else(|| text.parse().ok().and_then(Number::from_f64));
    number.map_or_else(|| text.into(), Value::Number)
}

/// Returns the entry of a YAML mapping with one of these names; `None` without one.
fn find<'a>(tree: &'a Value, names: &[&str]) -> Option<&'a Value> {
    let plain = |name: &str| name.to_lowercase().replace('_', "");
    let named = |(name, _): &(&String, &Value)| names.contains(&plain(name).as_str());
    Some(tree.as_object()?.iter().find(named)?.1)
}

fn missing(names: &[&str], expected: &str) -> String {
    format!("it has no `{}`, expected {expected}", names.join("` or `"))
}

/// Returns the whole number (pixels) that a YAML mapping holds under one of these names.
fn whole(tree: &Value, names: &[&str]) -> Result<usize, String> {
    let value = find(tree, names).and_then(Value::as_u64);
    let value = value.ok_or_else(|| missing(names, "a whole number of pixels"))?;
    usize::try_from(value).map_err(|error| error.to_string())
}

/// Returns the numbers under one of these names: a list, or a matrix with `rows`, `cols`, `data`.
fn numbers(tree: &Value, names: &[&str]) -> Result<Vec<f64>, String> {
    let expected = "a list of numbers, or `rows`, `cols` and `data`";
    let value = find(tree, names).ok_or_else(|| missing(names, expected))?;
    let list = value.get("data").unwrap_or(value);
    let numbers = list.as_array().and_then(|list| list.iter().map(Value::as_f64).collect());
    let numbers: Vec<f64> =
        numbers.ok_or_else(|| format!("its `{}` is not {expected}", names[0]))?;
    let size = ["rows", "cols"].map(|side| value.get(side).and_then(Value::as_u64));
    match size {
        [Some(rows), Some(cols)] if rows.checked_mul(cols) != Some(numbers.len() as u64) => Err(
            format!("its `{}` has {} numbers, expected {rows} x {cols}", names[0], numbers.len()),
        ),
        _ => Ok(numbers),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Camera file written by OpenCV 4, shortened.
    const OPENCV: &str = r#"%YAML:1.0
---
calibration_time: "Thu Nov 26 23:00:00 2026"
image_width: 640
image_height: 480
# flags: +fix_aspectRatio
flags: 10
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 6.1500000000000000e+02, 0., 317.5, 0., 615., 2.395e+02, 0.,
       0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0.1, -0.2, 0.001, -5.0000000000000001e-04, 0.3 ]
avg_reprojection_error: .Nan
image_points: !!opencv-matrix
   rows: 1
   cols: 2
   dt: "2f"
   data: [ 1.5, 2., 3., 4. ]
names:
   - "a: b"
"#;
    /// A file of ROS' `camera_info_manager`, with block sequences.
    const FILE: &str = "image_width: 640\nimage_height: 480\ncamera_name: head\ncamera_matrix:\n  \
        rows: 3\n  cols: 3\n  data:\n  - 615\n  - 0\n  - 317.5\n  - 0\n  - 615.0\n  - 239.5\n  - 0\n  \
        - 0\n  - 1\ndistortion_model: plumb_bob\ndistortion_coefficients: {rows: 1, cols: 5, data: \
        [0.1, -0.2, 0.001, -0.0005, 0.3]}\nrectification_matrix:\n  data: [1, 0, 0]\n";
    /// A printed message, which ROS 1 writes with capitals.
    const MESSAGE: &str = "header:\n  seq: 7\n  stamp:\n    secs: 1\n  frame_id: \"cam\"\nheight: 480\n\
        width: 640\ndistortion_model: \"rational_polynomial\"\nD: [0.1, -0.2, 0.001, -0.0005, 0.3, \
        0.0, 0.0, 0.0]\nK: [615.0, 0.0, 317.5, 0.0, 615.0, 239.5, 0.0, 0.0, 1.0]\nroi:\n  width: 0\n\
        ---\n";

    #[test]
    fn cameras_of_opencv_and_ros_are_read_with_pixels_that_begin_at_their_corner() {
        let lower = MESSAGE.replace("D:", "d:").replace("K:", "k:");
        let old = OPENCV.replace("camera_matrix", "Camera_Matrix").replace('\n', "\r\n");
        for text in [OPENCV, FILE, MESSAGE, &lower, &old, &OPENCV.replace("YAML:1.0", "YAML 1.2")] {
            let (intrinsics, lens) = parse(text).unwrap();
            assert_eq!(intrinsics, Intrinsics::REALSENSE_D435, "{text}");
            assert_eq!(lens.radial, [0.1, -0.2, 0.3, 0.0, 0.0, 0.0], "{text}");
            assert_eq!(lens.tangential, [0.001, -0.0005], "{text}");
        }
    }

    #[test]
    fn other_files_say_why_they_are_refused() {
        for (part, other, says) in [
            ("image_width: 640", "image_width: wide", "`imagewidth` or `width`"),
            ("image_height: 480\n", "", "`imageheight`"),
            ("camera_matrix", "matrix", "no `cameramatrix`"),
            ("317.5, 0., 615.", "317.5, 0.1, 615.", "skew"),
            ("317.5,", "x,", "not a list of numbers"),
            ("0.,\n       0., 1. ]", "0. ]", "expected 3 x 3"),
            ("cols: 5", "cols: 4", "has 5 numbers, expected 1 x 4"),
            ("0.1, -0.2, ", "0.1, ", "has 4 numbers, expected 1 x 5"),
            ("0.3 ]", ".nan ]", "not a list of numbers"),
            ("flags: 10", "fisheye_model: 1", "`fisheye`"),
            ("flags: 10", "distortion_model: equidistant", "`equidistant`, expected plumb_bob"),
            ("---\n", "---\n}", "no YAML"),
            (OPENCV, "size: [640, 480]", "no `cameramatrix`"),
            ("flags: 10", "flags: &ten 10\nagain: *ten", "alias"),
            ("camera_matrix:", "[camera_matrix]:", "expected a name"),
            (OPENCV, "", "camera"),
        ] {
            let text = OPENCV.replacen(part, other, 1);
            assert_ne!(text, OPENCV, "{part}");
            let problem = parse(&text).unwrap_err();
            assert!(problem.contains(says), "{other}: {problem}");
        }
        let path = Path::new("no/such/camera.yaml");
        let message = read_camera_intrinsics(path).unwrap_err().to_string();
        assert!(message.contains("camera.yaml"), "{message}");
    }
}
