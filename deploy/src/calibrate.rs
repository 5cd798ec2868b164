//! Where the camera is: found by a ball that the arm carries, kept in a file, and checked by the
//! arm's mask.

mod approach;
mod command;
mod file;
mod mask;
mod mask_command;
mod measure;
mod overlay;
mod poses;

#[cfg(test)]
mod blank;
#[cfg(test)]
mod refusals;
#[cfg(test)]
mod tests;

pub use command::CalibrateOptions;
pub use file::CalibrationFile;
pub use mask::{MaskCheck, MaskRow};
pub use mask_command::MaskOptions;
pub use measure::{CalibrateSettings, Calibrated, LeftOut, calibrate};
pub use poses::poses;
