//! File format of a camera's calibration.

use std::path::Path;

use glam::DMat3;
use inpainting::{CameraCalibration, Extrinsics, Intrinsics, LensDistortion};
use serde::{Deserialize, Serialize};

use crate::DeployError;
use experiments::RunError;
use learner::disk::{LocalDisk, write_atomically};
use learner::overrides::{parse_json, read_json};

/// Maximum coordinate of a camera's position (metres); a larger one must be in millimetres.
const FARTHEST: f64 = 100.0;

/// Contents of the JSON file with a camera's calibration that `covers calibrate` writes. Lengths
/// are in metres; all else is in pixels or has no unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraCalibrationFile {
    /// Width and height of the camera's pictures (pixels).
    pub size: [usize; 2],
    /// Horizontal and vertical focal length (pixels).
    pub focal: [f64; 2],
    /// Column and row of the optical axis (pixels).
    pub centre: [f64; 2],
    /// Coefficients of the radial distortion: k1 and k2, k1 to k3, or k1 to k6 of OpenCV's rational
    /// model.
    pub radial: Vec<f64>,
    /// Coefficients p1 and p2 of the tangential distortion.
    pub tangential: [f64; 2],
    /// Position of the camera (metres, world).
    pub position: [f64; 3],
    /// Rows of the rotation from the world's axes to the camera's: right, down, forwards.
    pub rotation: [[f64; 3]; 3],
}

impl CameraCalibrationFile {
    /// Reads a camera's calibration from a JSON file.
    ///
    /// # Errors
    /// [`RunError::Read`] with the file and the reason.
    pub fn read(path: &Path) -> Result<CameraCalibration, RunError> {
        let file: Self = read_json(path)?;
        file.calibration().map_err(RunError::read_error_mapper(path))
    }

    /// Reads a camera's calibration from JSON text.
    ///
    /// # Errors
    /// [`NotJson`](learner::LearnerError::NotJson),
    /// [`UnknownSetting`](learner::LearnerError::UnknownSetting),
    /// [`WrongSetting`](learner::LearnerError::WrongSetting); [`RunError::InvalidSetting`] for a
    /// position in millimetres, [`DeployError::Inpainting`] for numbers that no camera can have.
    pub fn parse(text: &str) -> Result<CameraCalibration, DeployError> {
        let file: Self = parse_json(text)?;
        file.calibration()
    }

    /// Writes a camera's calibration to a JSON file, which is replaced if it exists.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn write(calibration: &CameraCalibration, path: &Path) -> Result<(), DeployError> {
        let text = serde_json::to_string_pretty(&Self::from(calibration))
            .map_err(RunError::write_error_mapper(path))?
            + "\n";
        Ok(write_atomically(&LocalDisk, path, text.as_bytes())?)
    }

    fn calibration(self) -> Result<CameraCalibration, DeployError> {
        if self.position.iter().any(|place| place.abs() > FARTHEST) {
            return Err(RunError::invalid(
                "position",
                format!("{:?}", self.position),
                "metres, each at most 100",
            )
            .into());
        }
        let mut radial = [0.0; 6];
        let given = radial.get_mut(..self.radial.len());
        let given = given.filter(|given| matches!(given.len(), 2 | 3 | 6));
        let given = given.ok_or_else(|| {
            RunError::invalid(
                "radial",
                format!("{:?}", self.radial),
                "2, 3 or 6 numbers: k1 and k2, k1 to k3, or k1 to k6",
            )
        })?;
        given.copy_from_slice(&self.radial);
        let [width, height] = self.size;
        let rotation = DMat3::from_cols_array_2d(&self.rotation).transpose();
        let calibration = CameraCalibration {
            intrinsics: Intrinsics {
                width,
                height,
                focal_lengths: self.focal,
                principal_point: self.centre,
            },
            distortion: LensDistortion { radial, tangential: self.tangential },
            extrinsics: Extrinsics {
                rotation,
                translation: -(rotation * glam::DVec3::from_array(self.position)),
            },
        };
        calibration.check()?;
        Ok(calibration)
    }
}

impl From<&CameraCalibration> for CameraCalibrationFile {
    fn from(calibration: &CameraCalibration) -> Self {
        let inside = calibration.intrinsics;
        let rows = calibration.extrinsics.rotation.transpose();
        Self {
            size: [inside.width, inside.height],
            focal: inside.focal_lengths,
            centre: inside.principal_point,
            radial: match calibration.distortion.radial {
                [k1, k2, 0.0, 0.0, 0.0, 0.0] => vec![k1, k2],
                all => all.to_vec(),
            },
            tangential: calibration.distortion.tangential,
            position: calibration.camera_position().to_array(),
            rotation: rows.to_cols_array_2d(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> CameraCalibration {
        let rotation = DMat3::from_rotation_x(3.1) * DMat3::from_rotation_z(0.4);
        CameraCalibration {
            intrinsics: Intrinsics::REALSENSE_D435,
            distortion: LensDistortion::brown_conrady([0.01, -0.02], [0.001, 0.0]),
            extrinsics: Extrinsics { rotation, translation: glam::DVec3::new(0.1, -0.2, 1.4) },
        }
    }

    #[test]
    fn a_calibration_comes_back_from_its_file() {
        let name = format!("covers-calibration-{}.json", std::process::id());
        let path = std::env::temp_dir().join(name);
        CameraCalibrationFile::write(&camera(), &path).unwrap();
        let read = CameraCalibrationFile::read(&path);
        std::fs::remove_file(&path).unwrap();
        let read = read.unwrap();
        assert_eq!(read.extrinsics.rotation, camera().extrinsics.rotation);
        assert_eq!(read.intrinsics, camera().intrinsics);
        assert_eq!(read.distortion, camera().distortion);
        let off = read.camera_position().distance(camera().camera_position());
        assert!(off < 1e-12, "{off}");
        let gone = CameraCalibrationFile::read(&path).unwrap_err().to_string();
        assert!(gone.contains("covers-calibration"), "{gone}");
    }

    #[test]
    fn a_camera_in_millimetres_is_refused() {
        let mut file = CameraCalibrationFile::from(&camera());
        file.position = [0.3, -0.3, 1498.9];
        let text = serde_json::to_string(&file).unwrap();
        let message = CameraCalibrationFile::parse(&text).unwrap_err().to_string();
        assert!(message.contains("1498.9") && message.contains("metres"), "{message}");
    }

    #[test]
    fn files_that_are_no_camera_say_why() {
        let text = serde_json::to_string(&CameraCalibrationFile::from(&camera())).unwrap();
        CameraCalibrationFile::parse(&text).unwrap();
        for radial in ["-0.1,0.02,-0.01", "9.0,-20.0,4.0,9.1,-20.0,4.1"] {
            let more = text.replacen("0.01,-0.02", radial, 1);
            let again = CameraCalibrationFile::from(&CameraCalibrationFile::parse(&more).unwrap());
            assert!(serde_json::to_string(&again).unwrap().contains(radial), "{again:?}");
        }
        for (part, other, says) in [
            ("\"size\"", "\"sise\"", "did you mean `size`"),
            ("[640,480]", "[640]", "size"),
            ("[640,480]", "[0,480]", "picture size"),
            ("[615.0,615.0]", "[615.0,-1]", "focal length"),
            ("[615.0,615.0]", "[615.0,1e999]", "not valid JSON"),
            ("0.01,", "3.0,", "distortion"),
            ("0.01,", "0.0,0.0,0.01,", "k1 to k6"),
            ("n\":[[", "n\":[[3.0,0.0,0.0],[", "rotation"),
            ("n\":[[", "n\":[[9", "rotation"),
            ("}", "", "JSON"),
        ] {
            let spoilt = text.replacen(part, other, 1);
            assert_ne!(spoilt, text, "{part}");
            let message = CameraCalibrationFile::parse(&spoilt).unwrap_err().to_string();
            assert!(message.contains(says), "{other}: {message}");
        }
    }
}
