//! Fuzz target of camera calibrations.

use allocation_counter::opt_out;
use covers::deploy::CameraCalibrationFile;

use super::{Reading, Target, accepted, measured, texts};

pub const CALIBRATION: Target =
    Target::new("calibration", read, calibrations).holding(64, 1 << 12).tried(2_000);

fn read(input: &[u8]) -> Option<Reading> {
    let text = str::from_utf8(input).ok()?;
    measured(|| {
        let calibration = CameraCalibrationFile::parse(text);
        if let Ok(calibration) = &calibration {
            opt_out(|| assert!(calibration.check().is_ok(), "{text}"));
        }
        accepted(calibration)
    })
}

fn calibrations() -> Vec<Vec<u8>> {
    texts([
        r#"{"size": [640, 480], "focal": [615.0, 615.0], "centre": [318.0, 240.0],
            "radial": [0.01, -0.01], "tangential": [0.0005, -0.0005], "position": [0, 0, 1.5],
            "rotation": [[1, 0, 0], [0, -1, 0], [0, 0, -1]]}"#,
        r#"{"rotation": [[0.6, 0.8, 0], [0.8, -0.6, 0], [0, 0, -1]], "position": [-99, 0, 1e-300],
            "tangential": [0, 0], "radial": [0, 0, 0], "centre": [-1e300, 0], "focal": [1e-9, 1e300],
            "size": [1, 1]}"#,
        r#"{"size": [3000000000, 1000000000], "focal": [1, 1], "centre": [0, 0], "radial": [0, 0],
            "tangential": [0, 0], "position": [0, 0, 0], "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}"#,
        r#"{"size": [2, 2], "focal": [1, 1], "centre": [0, 0], "radial": [0.05, 0.01, 0, 0.01, 0, 0],
            "tangential": [0, 0], "position": [0, 0, 0], "rotation": [[0, 1, 0], [0, 0, 1], [1, 0, 0]]}"#,
        r#"{"size": [9, 2], "focal": [3, 1], "centre": [4.5, 1], "radial": [-0.1, 0],
            "tangential": [0, 0], "position": [0, 0, 2], "rotation": [[-1, 0, 0], [0, 1, 0], [0, 0, -1]]}"#,
        r#"{"size": [2, 2], "focal": [1, 1], "centre": [0, 0], "radial": [0.2, 0.1],
            "tangential": [0, 0], "position": [0, 0, 0], "rotation": [[1, 1, 0], [0, 0, 1], [1, 0, 0]]}"#,
    ])
}
