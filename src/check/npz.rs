//! Reader of numeric arrays in npz archives: zip files of npy files, as NumPy writes them.

use std::fs::File;
use std::io::{Read, Seek};
use std::path::Path;

use zip::ZipArchive;
use zip::result::ZipError;

/// Largest number of values in an array, so that a small hostile archive cannot fill the memory.
const MOST_VALUES: usize = 1 << 25;
/// Maximum size of an array's file in an archive (bytes): its values, and 64 KiB for the header.
const MOST_BYTES: u64 = 8 * MOST_VALUES as u64 + (1 << 16);

const TOO_LARGE: &str = "it has more than 2^25 values";

/// Open npz archive, a zip file of NumPy arrays.
pub(crate) struct Npz<R> {
    archive: ZipArchive<R>,
}

/// Array of numbers from an npz archive, in row-major order.
#[derive(Debug)]
pub(crate) struct Array {
    shape: Vec<usize>,
    values: Vec<f64>,
}

impl Array {
    /// Returns the part of the array at these indices of its leading axes.
    pub(crate) fn row(&self, indices: &[usize]) -> &[f64] {
        let start =
            indices.iter().zip(&self.shape).fold(0, |start, (index, size)| start * size + index);
        let len = self.shape[indices.len()..].iter().product::<usize>();
        &self.values[start * len..(start + 1) * len]
    }

    pub(crate) fn shape(&self) -> &[usize] {
        &self.shape
    }
}

impl Npz<File> {
    pub(crate) fn open(path: &Path) -> Result<Self, String> {
        Self::new(File::open(path).map_err(unreadable)?)
    }
}

impl<R: Read + Seek> Npz<R> {
    pub(crate) fn new(file: R) -> Result<Self, String> {
        Ok(Self { archive: ZipArchive::new(file).map_err(not_an_archive)? })
    }

    /// Reads the array `name` of finite numbers with the shape `expected`, in which 0 stands for
    /// any positive size.
    pub(crate) fn array(&mut self, name: &str, expected: &[usize]) -> Result<Array, String> {
        let array = parse(name, &self.member(name)?)?;
        let fits = |(&got, &wanted): (&usize, &usize)| got > 0 && (wanted == 0 || got == wanted);
        if array.shape.len() != expected.len() || !array.shape.iter().zip(expected).all(fits) {
            return Err(format!(
                "the array `{name}` has the shape {:?}, expected {expected:?} (0 stands for any)",
                array.shape
            ));
        }
        match array.values.iter().position(|value| !value.is_finite()) {
            Some(index) => Err(format!(
                "the array `{name}` has a value that is not finite at index {index} (row-major order)"
            )),
            None => Ok(array),
        }
    }

    fn member(&mut self, name: &str) -> Result<Vec<u8>, String> {
        let Some(index) = self.archive.index_for_name(&format!("{name}.npy")) else {
            let known = self.archive.file_names().filter_map(Result::ok);
            let known: Vec<_> = known.map(|known| known.into_owned()).collect();
            return Err(format!(
                "the array `{name}` is missing among those of the archive: {}",
                known.join(", ")
            ));
        };
        let file = self.archive.by_index(index).map_err(not_an_archive)?;
        if file.size() > MOST_BYTES {
            return Err(damaged(name, TOO_LARGE));
        }
        let mut bytes = Vec::new();
        // the size in the archive's header may be false, so the number of bytes read is limited too
        file.take(MOST_BYTES).read_to_end(&mut bytes).map_err(unreadable)?;
        Ok(bytes)
    }
}

/// Parses the npy format, versions 1 to 3: magic number, version, length of the header, header (a
/// Python dictionary), values.
fn parse(name: &str, bytes: &[u8]) -> Result<Array, String> {
    let damaged = |reason| damaged(name, reason);
    let rest = bytes
        .strip_prefix(b"\x93NUMPY")
        .ok_or_else(|| damaged("it does not begin as an npy file"))?;
    let (len, start) = match rest {
        [1, _, a, b, ..] => (usize::from(u16::from_le_bytes([*a, *b])), 4),
        [2 | 3, _, a, b, c, d, ..] => (u32::from_le_bytes([*a, *b, *c, *d]) as usize, 6),
        _ => return Err(damaged("its version is not 1, 2 or 3")),
    };
    let header = rest
        .get(start..start + len)
        .and_then(|header| std::str::from_utf8(header).ok())
        .ok_or_else(|| damaged("its header ends early or is not text"))?;
    let shape = shape(header).ok_or_else(|| damaged("its header has no shape in C order"))?;
    let values = values(name, kind(header), &rest[start + len..])?;
    let count = shape.iter().try_fold(1, |n: usize, &size| n.checked_mul(size));
    if count != Some(values.len()) {
        return Err(damaged("it holds more or fewer values than its shape says"));
    }
    Ok(Array { shape, values })
}

/// Returns the element type in an npy header without its quotes, for instance `<f8`; empty without
/// one.
fn kind(header: &str) -> &str {
    let after = header.split_once("'descr'").map_or("", |(_, after)| after);
    after.split('\'').nth(1).unwrap_or_default()
}

fn shape(header: &str) -> Option<Vec<usize>> {
    header.contains("'fortran_order': False").then_some(())?;
    let (_, after) = header.split_once("'shape': (")?;
    let (inside, _) = after.split_once(')')?;
    let sizes = inside.split(',').map(str::trim);
    sizes.filter(|size| !size.is_empty()).map(|size| size.parse().ok()).collect()
}

fn values(name: &str, kind: &str, bytes: &[u8]) -> Result<Vec<f64>, String> {
    let damaged = |reason| Err(damaged(name, reason));
    let (numbers, rest) = bytes.as_chunks::<8>();
    match kind {
        "<f8" if numbers.len() > MOST_VALUES => damaged(TOO_LARGE),
        "|b1" if bytes.len() > MOST_VALUES => damaged(TOO_LARGE),
        "<f8" if !rest.is_empty() => damaged("its last number is cut"),
        "<f8" => Ok(numbers.iter().map(|&n| f64::from_le_bytes(n)).collect()),
        "|b1" => Ok(bytes.iter().map(|&byte| f64::from(byte)).collect()),
        _ => Err(format!(
            "the array `{name}` holds values of kind `{kind}`, expected `<f8` (64-bit numbers) or `|b1` \
             (truth values)"
        )),
    }
}

/// Returns the error message for a file that cannot be read, with the system's reason.
pub(crate) fn unreadable(error: std::io::Error) -> String {
    format!("it cannot be read: {error}")
}

fn not_an_archive(error: ZipError) -> String {
    format!("it is not an npz archive: {error}")
}

fn damaged(name: &str, reason: &str) -> String {
    format!("the array `{name}` is damaged: {reason}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns an npy file of version 1 that holds so many truths.
    fn npy(count: usize) -> Vec<u8> {
        let header = format!("{{'descr': '|b1', 'fortran_order': False, 'shape': ({count},), }}\n");
        let len = (header.len() as u16).to_le_bytes();
        [b"\x93NUMPY\x01\x00", &len[..], header.as_bytes(), &vec![1; count]].concat()
    }

    #[test]
    fn values_are_counted_and_not_bytes() {
        assert_eq!(parse("it", &npy(MOST_VALUES)).unwrap().shape(), [MOST_VALUES]);
        let reason = parse("it", &npy(MOST_VALUES + 1)).unwrap_err();
        assert!(reason.contains("more than 2^25 values"), "{reason}");
    }
}
