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
pub use calibration::Calibration;
pub use camera::{Extrinsics, Intrinsics, PinholeCamera};
pub use color::ColorCorrection;
pub use distortion::Distortion;
pub use error::InpaintingError;
pub use hand_eye::{
    BallOffset, BallSighting, FocalLengthEstimate, HandEyeCalibration, HandEyeSettings,
    MIN_CALIBRATION_POSES, Residual, Uncertainty,
};
pub use imperfections::CameraImperfections;
pub use inpainter::{Inpainter, InpainterSettings};
pub use links::ArmLink;
pub use mark::GripperMark;
pub use perception::{Perception, PerceptionSettings};
pub use simulated_camera::SimulatedCamera;
