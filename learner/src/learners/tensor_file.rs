//! Checkpoints: named arrays, one header of JSON and a checksum in a safetensors file.

use std::ops::Range;
use std::path::Path;

use safetensors::SafeTensorError;
use safetensors::tensor::{Dtype, Metadata, SafeTensors, TensorView};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::error::LearnerError;

/// Number of the checkpoint's file format, which increases with every change that older versions
/// could not read.
pub(super) const FORMAT_VERSION: u32 = 5;
/// Metadata key of a safetensors file under which the JSON header is stored.
const KEY: &str = "covers";
/// Name of the array that holds the checksum of the file.
const CHECKSUM: &str = "checksum";
/// Number of bytes of a safetensors file before its header: those of the header's length.
const LENGTH_BYTES: usize = 8;

/// JSON header of a checkpoint as it is written: format number and contents.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Envelope<H> {
    format: u32,
    header: H,
}

/// Part of a checkpoint's JSON header that every version can read: the format number.
#[derive(Deserialize)]
struct Format {
    format: u32,
}

/// Named array of numbers or bytes in a checkpoint file.
pub struct CheckpointTensor {
    name: String,
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl CheckpointTensor {
    /// Creates a named array of single-precision numbers for a checkpoint.
    pub fn from_floats(name: String, shape: Vec<usize>, values: &[f32]) -> Self {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        Self { name, dtype: Dtype::F32, shape, bytes }
    }

    /// Creates a named array of whole numbers for a checkpoint.
    pub fn from_integers(name: String, shape: Vec<usize>, values: &[u64]) -> Self {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        Self { name, dtype: Dtype::U64, shape, bytes }
    }

    /// Rejects an array with numbers that are not finite.
    fn check(&self, path: &Path) -> Result<(), LearnerError> {
        if self.dtype != Dtype::F32 {
            return Ok(());
        }
        let (numbers, _) = self.bytes.as_chunks::<4>();
        let mut values = numbers.iter().map(|b| f32::from_le_bytes(*b)).enumerate();
        match values.find(|(_, value)| !value.is_finite()) {
            None => Ok(()),
            Some((index, value)) => Err(LearnerError::NotFinite {
                path: path.to_owned(),
                tensor: self.name.clone(),
                index,
                value,
            }),
        }
    }

    /// Creates a named array of bytes for a checkpoint.
    pub fn from_bytes(name: String, shape: Vec<usize>, bytes: Vec<u8>) -> Self {
        Self { name, dtype: Dtype::U8, shape, bytes }
    }
}

/// Returns the bytes of a checkpoint file with a header and arrays. Equal contents give equal
/// bytes.
///
/// # Errors
/// [`LearnerError::NotFinite`], [`LearnerError::Write`] for the file at `path`, which is not
/// touched.
pub(super) fn encode_tensor_file(
    path: &Path,
    header: &impl Serialize,
    tensors: &[CheckpointTensor],
) -> Result<Vec<u8>, LearnerError> {
    tensors.iter().try_for_each(|tensor| tensor.check(path))?;
    let envelope = Envelope { format: FORMAT_VERSION, header };
    let text = serde_json::to_string(&envelope).map_err(|e| LearnerError::cannot_write(path, e))?;
    let bytes = serialize(tensors, text).and_then(insert_checksum);
    bytes.map_err(|error| LearnerError::cannot_write(path, error))
}

/// Returns the bytes of a checkpoint file, with zeros in place of the checksum.
fn serialize(tensors: &[CheckpointTensor], header: String) -> Result<Vec<u8>, SafeTensorError> {
    let space = CheckpointTensor::from_bytes(CHECKSUM.to_owned(), vec![4], vec![0; 4]);
    let mut views = Vec::with_capacity(tensors.len() + 1);
    for tensor in tensors.iter().chain([&space]) {
        let view = TensorView::new(tensor.dtype, tensor.shape.clone(), &tensor.bytes)?;
        views.push((&tensor.name, view));
    }
    // a single key, since the order of several could vary and with it the bytes of the file
    let metadata = [(KEY.to_owned(), header)].into_iter().collect();
    safetensors::serialize(views, Some(metadata))
}

/// Writes the checksum of a checkpoint file into its array.
fn insert_checksum(mut bytes: Vec<u8>) -> Result<Vec<u8>, SafeTensorError> {
    let (length, metadata) = SafeTensors::read_metadata(&bytes)?;
    let Some(range) = checksum_range(length, &metadata) else {
        return Err(SafeTensorError::TensorNotFound(CHECKSUM.to_owned()));
    };
    let checksum = checksum(&bytes, range.clone());
    bytes[range].copy_from_slice(&checksum.to_le_bytes());
    Ok(bytes)
}

/// Returns the byte range of the checksum in a file whose header has `length` bytes.
fn checksum_range(length: usize, metadata: &Metadata) -> Option<Range<usize>> {
    let (from, to) = metadata.info(CHECKSUM)?.data_offsets;
    let start = length + LENGTH_BYTES;
    (to - from == 4).then_some(start + from..start + to)
}

/// Returns the CRC-32 (IEEE 802.3) of the whole file, with zeros in place of the checksum itself.
/// It detects every flipped bit and every burst of up to 32 damaged bits.
fn checksum(bytes: &[u8], place: Range<usize>) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&bytes[..place.start]);
    hasher.update(&[0; 4]);
    hasher.update(&bytes[place.end..]);
    hasher.finalize()
}

fn check_checksum(
    path: &Path,
    bytes: &[u8],
    length: usize,
    metadata: &Metadata,
) -> Result<(), LearnerError> {
    let damaged = |problem| Err(LearnerError::damaged_file(path, problem));
    let Some(place) = checksum_range(length, metadata) else {
        return damaged(format!("it holds no `{CHECKSUM}`: this is not a checkpoint of covers"));
    };
    let found = checksum(bytes, place.clone());
    let (written, _) = bytes[place].as_chunks::<4>();
    match written {
        [written] if u32::from_le_bytes(*written) == found => Ok(()),
        _ => damaged("its checksum is wrong: it was damaged after it was written".to_owned()),
    }
}

fn check_format(path: &Path, format: u32) -> Result<(), LearnerError> {
    match format {
        FORMAT_VERSION => Ok(()),
        newer if newer > FORMAT_VERSION => Err(LearnerError::NewerFormat {
            path: path.to_owned(),
            format: newer,
            known: FORMAT_VERSION,
        }),
        older => {
            let problem = format!("its format is {older}, expected {FORMAT_VERSION}");
            Err(LearnerError::damaged_file(path, problem))
        }
    }
}

/// Arrays of an opened checkpoint file.
pub struct TensorFile<'a> {
    path: &'a Path,
    file: SafeTensors<'a>,
}

impl<'a> TensorFile<'a> {
    /// Parses `bytes`, the checkpoint file at `path`, into header and arrays; verifies its
    /// checksum.
    pub fn open<H: DeserializeOwned>(
        path: &'a Path,
        bytes: &'a [u8],
    ) -> Result<(H, Self), LearnerError> {
        let read = |error: SafeTensorError| LearnerError::cannot_read(path, error);
        let (length, metadata) = SafeTensors::read_metadata(bytes).map_err(read)?;
        check_checksum(path, bytes, length, &metadata)?;
        let header = metadata.metadata().as_ref().and_then(|m| m.get(KEY));
        let header = header.ok_or_else(|| {
            LearnerError::damaged_file(path, format!("there is no metadata `{KEY}`"))
        })?;
        let read_json = |error| LearnerError::cannot_read(path, error);
        let Format { format } = serde_json::from_str(header).map_err(read_json)?;
        // the format is read alone first: headers of other formats may have other fields
        check_format(path, format)?;
        let other_method = |error: serde_json::Error| LearnerError::OtherMethod {
            path: path.to_owned(),
            problem: error.to_string(),
        };
        let Envelope { header, .. } = serde_json::from_str(header).map_err(other_method)?;
        let file = SafeTensors::deserialize(bytes).map_err(read)?;
        Ok((header, Self { path, file }))
    }

    /// Returns the error of a checkpoint file whose contents contradict each other.
    pub fn damaged_error(&self, problem: String) -> LearnerError {
        LearnerError::damaged_file(self.path, problem)
    }

    /// Returns `true` if the file has an array called `name`.
    pub fn contains(&self, name: &str) -> bool {
        self.file.tensor(name).is_ok()
    }

    /// Returns shape and values of the single-precision array called `name`, all values finite.
    pub fn read_floats(&self, name: &str) -> Result<(Vec<usize>, Vec<f32>), LearnerError> {
        let tensor = self.tensor(name, Dtype::F32)?;
        let (numbers, _) = tensor.data().as_chunks::<4>();
        let values: Vec<f32> = numbers.iter().map(|b| f32::from_le_bytes(*b)).collect();
        if let Some(index) = values.iter().position(|value| !value.is_finite()) {
            let problem = format!("`{name}`[{index}] is {}, expected a number", values[index]);
            return Err(self.damaged_error(problem));
        }
        Ok((tensor.shape().to_vec(), values))
    }

    /// Returns the values of the array of whole numbers called `name`.
    pub fn read_integers(&self, name: &str) -> Result<Vec<u64>, LearnerError> {
        let tensor = self.tensor(name, Dtype::U64)?;
        let (numbers, _) = tensor.data().as_chunks::<8>();
        Ok(numbers.iter().map(|b| u64::from_le_bytes(*b)).collect())
    }

    /// Returns shape and values of the array of bytes called `name`.
    pub fn read_bytes(&self, name: &str) -> Result<(Vec<usize>, Vec<u8>), LearnerError> {
        let tensor = self.tensor(name, Dtype::U8)?;
        Ok((tensor.shape().to_vec(), tensor.data().to_vec()))
    }

    /// Returns the array of bytes called `name` as UTF-8 text.
    pub fn read_text(&self, name: &str) -> Result<String, LearnerError> {
        let text = String::from_utf8(self.read_bytes(name)?.1);
        text.map_err(|error| self.damaged_error(format!("`{name}` is not text: {error}")))
    }

    fn tensor(&self, name: &str, dtype: Dtype) -> Result<TensorView<'_>, LearnerError> {
        let tensor = self.file.tensor(name);
        let tensor = tensor.map_err(|error| LearnerError::cannot_read(self.path, error))?;
        if tensor.dtype() == dtype {
            return Ok(tensor);
        }
        let problem = format!("`{name}` is {:?}, expected {dtype:?}", tensor.dtype());
        Err(self.damaged_error(problem))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written() -> Vec<u8> {
        let tensors = [
            CheckpointTensor::from_floats("a".to_owned(), vec![3], &[1.0, -2.0, 0.5]),
            CheckpointTensor::from_bytes("z".to_owned(), vec![2, 2], vec![1, 2, 3, 4]),
        ];
        encode_tensor_file(Path::new("file"), &"a note", &tensors).unwrap()
    }

    fn open(bytes: &[u8]) -> Result<String, LearnerError> {
        TensorFile::open(Path::new("file"), bytes).map(|(header, _)| header)
    }

    #[test]
    fn every_flipped_bit_and_every_cut_is_noticed() {
        let whole = written();
        assert_eq!(open(&whole).unwrap(), "a note");
        for bit in 0..8 * whole.len() {
            let mut flipped = whole.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            assert!(open(&flipped).is_err(), "bit {bit}");
        }
        for length in 0..whole.len() {
            assert!(open(&whole[..length]).is_err(), "{length} bytes");
        }
    }

    #[test]
    fn an_intact_file_of_another_method_is_named_with_the_remedy() {
        let bytes = written();
        let opened = TensorFile::open::<Vec<usize>>(Path::new("file"), &bytes);
        let message = opened.map(|_| ()).unwrap_err().to_string();
        assert!(message.starts_with("file is intact, but of another method"), "{message}");
        assert!(message.contains("put back the experiment.json"), "{message}");
    }

    #[test]
    fn a_newer_format_is_named() {
        let text = serde_json::json!({ "format": FORMAT_VERSION + 1, "news": true });
        let bytes = serialize(&[], text.to_string()).and_then(insert_checksum).unwrap();
        let message = open(&bytes).unwrap_err().to_string();
        assert!(message.contains(&format!("has format {}", FORMAT_VERSION + 1)), "{message}");
    }

    #[test]
    fn a_header_that_no_reader_takes_is_not_written() {
        let header = "row\n".repeat(25_000_000);
        let message = encode_tensor_file(Path::new("file"), &header, &[]).unwrap_err().to_string();
        assert!(message.contains("cannot write file: header too large"), "{message}");
    }

    #[test]
    fn numbers_that_are_not_finite_are_not_written() {
        let tensors =
            [CheckpointTensor::from_floats("weights".to_owned(), vec![2], &[1.0, f32::NAN])];
        let error = encode_tensor_file(Path::new("file"), &"", &tensors).unwrap_err();
        assert!(error.to_string().contains("`weights`[1] is NaN"), "{error}");
    }
}
