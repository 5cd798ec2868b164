//! What several files of tests share.

pub mod bars;
pub mod onnx;
pub mod packed;
pub mod protobuf;
pub mod scratch;
