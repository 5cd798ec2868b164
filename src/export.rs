//! Policies for other programs: ONNX, and plain safetensors for PyTorch.

mod command;
mod description;
mod graph;
mod onnx;
mod weights;

pub use command::ExportOptions;
