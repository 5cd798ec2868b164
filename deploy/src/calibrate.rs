//! Calibration of the camera by a ball that the arm carries, its file, and its check by the arm's
//! mask.

mod approach;
mod camera_file;
mod command;
mod file;
mod mask;
mod mask_command;
mod measure;
mod overlay;
mod poses;

#[cfg(test)]
mod refusals;
#[cfg(test)]
mod tests;

pub use command::CalibrateOptions;
pub use file::CameraCalibrationFile;
pub use mask::{MaskCheck, MaskComparison};
pub use mask_command::CheckMaskOptions;
pub use measure::{
    CameraCalibrationResult, CameraCalibrationSettings, SkippedPose, calibrate_camera,
};
pub use poses::calibration_poses;
