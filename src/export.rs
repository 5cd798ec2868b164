//! Export of policies for other programs: ONNX, and safetensors for PyTorch.

mod command;
mod description;
mod graph;
mod onnx;
mod weights;

pub use command::ExportOptions;
