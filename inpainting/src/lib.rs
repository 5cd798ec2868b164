#![doc = include_str!("../README.md")]

mod ball;
mod calibration;
mod camera;
mod color;
mod distortion;
mod drift;
mod error;
mod hand_eye;
mod imperfections;
mod inpainter;
mod links;
mod mark;
mod moments;
mod perception;
mod sensor;
mod simulated_camera;
mod warp;

pub use ball::CalibrationBall;
pub use calibration::CameraCalibration;
pub use camera::{Extrinsics, Intrinsics, PinholeCamera};
pub use color::ColorCorrection;
pub use distortion::LensDistortion;
pub use error::InpaintingError;
pub use hand_eye::{
    BallOffsetInHand, BallResidual, BallSighting, FocalLengthEstimate, HandEyeCalibration,
    HandEyeSettings, HandEyeUncertainty, MIN_CALIBRATION_POSES,
};
pub use imperfections::CameraImperfections;
pub use inpainter::{Inpainter, InpainterSettings};
pub use links::ArmLink;
pub use mark::GripperMark;
pub use perception::{Perception, PerceptionSettings};
pub use simulated_camera::SimulatedCamera;
