//! What several files of tests share.

pub mod onnx;
pub mod packed;
pub mod protobuf;
pub mod scratch;
