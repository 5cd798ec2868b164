//! Saving and loading of networks as safetensors files.

use std::path::{Path, PathBuf};

use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensorError, SafeTensors};
use thiserror::Error;

use crate::layers::layer::{Layer, flatten_layers};

/// Key of the only metadata entry in a network's safetensors file. Several entries would have no
/// fixed order; with one, equal networks give equal bytes.
const METADATA: &str = "covers-equivariant 1";

/// Reason why the parameters of a network were not saved or loaded.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SafetensorsError {
    /// File that cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Path of the file that cannot be read or written.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// File that is not in the safetensors format.
    #[error("{}: not a safetensors file: {source}", path.display())]
    Format {
        /// Path of the file that is not in the safetensors format.
        path: PathBuf,
        /// Error of the safetensors parser.
        source: SafeTensorError,
    },
    /// File that was not written by [`save_safetensors`].
    #[error("{}: got no metadata `{METADATA}`, expected a file that this crate saved", path.display())]
    Metadata {
        /// Path of the file without this crate's metadata.
        path: PathBuf,
    },
    /// File whose layers differ from those of the network.
    #[error("{}: layer {index} is `{got}` in the file and `{expected}` in the network", path.display())]
    Layer {
        /// Path of the file that holds other layers.
        path: PathBuf,
        /// Position, from 0, of the first layer that differs, in the list of all layers including
        /// those of nested chains.
        index: usize,
        /// Description of the layer in the file, or `nothing` if the file has fewer layers.
        got: String,
        /// Description of the layer in the network, or `nothing` if the network has fewer layers.
        expected: String,
    },
    /// Parameters of a layer that are missing in the file or have another type or number there.
    #[error("{}: got `{name}` as {got}, expected F32 {expected:?}", path.display())]
    Tensor {
        /// Path of the file with the missing or wrong tensor.
        path: PathBuf,
        /// Name of the tensor in the file.
        name: String,
        /// Type and shape of the tensor in the file, or `nothing` if the tensor is missing.
        got: String,
        /// Shape of the tensor that the layer requires.
        expected: [usize; 1],
    },
}

/// Saves a layer or a chain of layers with its parameters as a safetensors file.
///
/// Layers are numbered in order, including those of nested chains. Layer `i` with parameters has
/// the tensor `i.params`, which [`load_safetensors`] reads. For other libraries there are
/// `i.kernel` `[C_out, C_in, size, size]` and `i.bias` `[C_out]`, an ordinary convolution in the
/// regular basis ([`OrdinaryConv::regular_kernel`](crate::OrdinaryConv::regular_kernel)). The
/// metadata `covers-equivariant 1` holds one line for each layer: its description.
///
/// # Errors
/// When the file cannot be written.
///
/// # Panics
/// When `params` does not hold the layer's parameters.
pub fn save_safetensors(
    path: impl AsRef<Path>,
    layer: &dyn Layer<f32>,
    params: &[f32],
) -> Result<(), SafetensorsError> {
    let path = path.as_ref();
    let (got, expected) = (params.len(), layer.num_params());
    assert!(got == expected, "got {got} parameters, expected {expected}");
    let layers = flatten_layers(layer);
    let tensors = tensors(&layers, params);
    let views = tensors.iter().map(|(name, shape, bytes)| {
        TensorView::new(Dtype::F32, shape.clone(), bytes).map(|view| (name, view))
    });
    let views: Result<Vec<_>, _> = views.collect();
    let metadata = [(METADATA.to_owned(), describe(&layers))];
    let bytes = views
        .and_then(|views| safetensors::serialize(views, Some(metadata.into_iter().collect())))
        .map_err(|source| format_error(path, source))?;
    std::fs::write(path, bytes).map_err(|source| io_error(path, source))
}

/// Loads the parameters of a layer or a chain of layers that [`save_safetensors`] wrote.
///
/// # Errors
/// When the file cannot be read, or holds other layers than `layer`. Layers are compared by their
/// descriptions: kind, types, window, and all other settings.
pub fn load_safetensors(
    path: impl AsRef<Path>,
    layer: &dyn Layer<f32>,
) -> Result<Vec<f32>, SafetensorsError> {
    let path = path.as_ref();
    let bytes = std::fs::read(path).map_err(|source| io_error(path, source))?;
    let (_, header) =
        SafeTensors::read_metadata(&bytes).map_err(|source| format_error(path, source))?;
    let entry = header.metadata().as_ref().and_then(|entries| entries.get(METADATA));
    let lines = entry.ok_or_else(|| SafetensorsError::Metadata { path: path.to_owned() })?;
    let layers = flatten_layers(layer);
    // descriptions first, so that the error names the layer that differs rather than a tensor
    compare(path, lines, &layers)?;
    let file = SafeTensors::deserialize(&bytes).map_err(|source| format_error(path, source))?;
    let mut params = Vec::with_capacity(layer.num_params());
    for (i, part) in layers.iter().enumerate() {
        if part.num_params() > 0 {
            params.extend(read(path, &file, format!("{i}.params"), part.num_params())?);
        }
    }
    Ok(params)
}

/// Returns the descriptions of the layers as text, one on each line.
fn describe(layers: &[&dyn Layer<f32>]) -> String {
    let lines: Vec<String> = layers.iter().map(|layer| layer.to_string()).collect();
    lines.join("\n")
}

/// Name, shape and little-endian bytes of a tensor.
type Tensor = (String, Vec<usize>, Vec<u8>);

/// Returns the tensors of all layers for a safetensors file.
fn tensors(layers: &[&dyn Layer<f32>], mut params: &[f32]) -> Vec<Tensor> {
    let mut tensors = Vec::new();
    let mut push = |name: String, shape: &[usize], values: &[f32]| {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        tensors.push((name, shape.to_vec(), bytes));
    };
    for (i, layer) in layers.iter().enumerate() {
        let (own, rest) = params.split_at(layer.num_params());
        params = rest;
        if own.is_empty() {
            continue;
        }
        push(format!("{i}.params"), &[own.len()], own);
        if let Some(dense) = layer.kind().as_ordinary_conv() {
            let (kernel, bias) = (dense.regular_kernel(own), dense.regular_bias(own));
            push(format!("{i}.kernel"), &dense.kernel_shape(), &kernel);
            push(format!("{i}.bias"), &[bias.len()], &bias);
        }
    }
    tensors
}

/// Returns an error if the file's layers differ from those of the network.
fn compare(path: &Path, lines: &str, layers: &[&dyn Layer<f32>]) -> Result<(), SafetensorsError> {
    let mut got = lines.lines();
    let mut expected = layers.iter().map(|layer| layer.to_string());
    for index in 0.. {
        match (got.next(), expected.next()) {
            (None, None) => break,
            (Some(got), Some(expected)) if got == expected => {}
            (got, expected) => {
                return Err(SafetensorsError::Layer {
                    path: path.to_owned(),
                    index,
                    got: got.unwrap_or("nothing").to_owned(),
                    expected: expected.unwrap_or_else(|| "nothing".to_owned()),
                });
            }
        }
    }
    Ok(())
}

/// Reads the tensor of a layer's parameters from a safetensors file.
fn read(
    path: &Path,
    file: &SafeTensors,
    name: String,
    len: usize,
) -> Result<Vec<f32>, SafetensorsError> {
    let found = file.tensor(&name).ok();
    let fits = |t: &TensorView| t.dtype() == Dtype::F32 && t.shape() == [len];
    match found {
        Some(tensor) if fits(&tensor) => {
            let (values, _) = tensor.data().as_chunks();
            Ok(values.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect())
        }
        found => Err(SafetensorsError::Tensor {
            path: path.to_owned(),
            name,
            got: found.map_or_else(
                || "nothing".to_owned(),
                |t| format!("{:?} {:?}", t.dtype(), t.shape()),
            ),
            expected: [len],
        }),
    }
}

fn io_error(path: &Path, source: std::io::Error) -> SafetensorsError {
    let path = path.to_owned();
    SafetensorsError::Io { path, source }
}

fn format_error(path: &Path, source: SafeTensorError) -> SafetensorsError {
    let path = path.to_owned();
    SafetensorsError::Format { path, source }
}
