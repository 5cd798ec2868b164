//! Checkpoints: named arrays and one header of JSON in a safetensors file.

use std::path::Path;

use safetensors::SafeTensorError;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::CoversError;

/// One array of a file.
pub(super) struct Tensor {
    name: String,
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Tensor {
    /// An array of numbers.
    pub fn floats(name: String, shape: Vec<usize>, values: &[f32]) -> Self {
        Self {
            name,
            dtype: Dtype::F32,
            shape,
            bytes: values.iter().flat_map(|v| v.to_le_bytes()).collect(),
        }
    }

    /// An array of bytes.
    pub fn bytes(name: String, shape: Vec<usize>, bytes: Vec<u8>) -> Self {
        Self {
            name,
            dtype: Dtype::U8,
            shape,
            bytes,
        }
    }
}

/// Writes a header under `key` and arrays. The file appears whole or not at all, and equal contents
/// give equal bytes.
pub(super) fn write(
    path: &Path,
    key: &str,
    header: &impl Serialize,
    tensors: &[Tensor],
) -> Result<(), CoversError> {
    let header = serde_json::to_string(header).map_err(|e| CoversError::write(path, e))?;
    let bytes = encode(tensors, key, header).map_err(|e| CoversError::write(path, e))?;
    replace(path, &bytes).map_err(|error| CoversError::write(path, error))
}

/// There is one key of metadata, since the order of several could vary.
fn encode(tensors: &[Tensor], key: &str, header: String) -> Result<Vec<u8>, SafeTensorError> {
    let mut views = Vec::with_capacity(tensors.len());
    for tensor in tensors {
        let view = TensorView::new(tensor.dtype, tensor.shape.clone(), &tensor.bytes)?;
        views.push((&tensor.name, view));
    }
    let metadata = [(key.to_owned(), header)].into_iter().collect();
    safetensors::serialize(views, Some(metadata))
}

/// Writes a file beside `path` and renames it: an interruption leaves the old one.
fn replace(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let partial = path.with_extension("partial");
    std::fs::write(&partial, bytes)?;
    std::fs::rename(partial, path)
}

/// The arrays of an open file.
pub(super) struct TensorFile<'a> {
    path: &'a Path,
    file: SafeTensors<'a>,
}

impl<'a> TensorFile<'a> {
    /// Opens the bytes of the file at `path`, whose header stands under `key`.
    pub fn open<H: DeserializeOwned>(
        path: &'a Path,
        bytes: &'a [u8],
        key: &str,
    ) -> Result<(H, Self), CoversError> {
        let read = |error: SafeTensorError| CoversError::read(path, error);
        let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(read)?;
        let header = metadata.metadata().as_ref().and_then(|m| m.get(key));
        let header = header
            .ok_or_else(|| CoversError::damaged(path, format!("there is no metadata `{key}`")))?;
        let header = serde_json::from_str(header).map_err(|e| CoversError::read(path, e))?;
        let file = SafeTensors::deserialize(bytes).map_err(read)?;
        Ok((header, Self { path, file }))
    }

    /// The error of a file whose contents do not fit together.
    pub fn damaged(&self, problem: String) -> CoversError {
        CoversError::damaged(self.path, problem)
    }

    /// Shape and values of an array of numbers, all of them finite.
    pub fn floats(&self, name: &str) -> Result<(Vec<usize>, Vec<f32>), CoversError> {
        let tensor = self.tensor(name, Dtype::F32)?;
        let (numbers, _) = tensor.data().as_chunks::<4>();
        let values: Vec<f32> = numbers.iter().map(|b| f32::from_le_bytes(*b)).collect();
        if let Some(index) = values.iter().position(|value| !value.is_finite()) {
            let problem = format!("`{name}`[{index}] is {}, expected a number", values[index]);
            return Err(self.damaged(problem));
        }
        Ok((tensor.shape().to_vec(), values))
    }

    /// Shape and values of an array of bytes.
    pub fn bytes(&self, name: &str) -> Result<(Vec<usize>, Vec<u8>), CoversError> {
        let tensor = self.tensor(name, Dtype::U8)?;
        Ok((tensor.shape().to_vec(), tensor.data().to_vec()))
    }

    fn tensor(&self, name: &str, dtype: Dtype) -> Result<TensorView<'_>, CoversError> {
        let tensor = self.file.tensor(name);
        let tensor = tensor.map_err(|error| CoversError::read(self.path, error))?;
        if tensor.dtype() == dtype {
            return Ok(tensor);
        }
        let problem = format!("`{name}` is {:?}, expected {dtype:?}", tensor.dtype());
        Err(self.damaged(problem))
    }
}
