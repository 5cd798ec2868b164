//! Format that all files of tensors share.

use std::ops::Range;

use serde_json::Value;

/// Builds a checkpoint from its parts: its metadata (JSON), the list of its arrays (JSON), and
/// their bytes. Lengths and the checksum are computed, so that mutations of a part get past their
/// checks.
pub fn sealed(envelope: &str, arrays: &str, data: &[u8]) -> Option<Vec<u8>> {
    let envelope = Value::from(envelope);
    let arrays = arrays.strip_prefix('{')?;
    let header = format!(r#"{{"__metadata__":{{"covers":{envelope}}},{arrays}"#);
    let length = (header.len() as u64).to_le_bytes();
    let mut file = [&length[..], header.as_bytes(), data].concat();
    if let Some(place) = checksum_place(&header, file.len() - data.len()) {
        let checksum = crc32fast::hash(&file);
        file.get_mut(place)?.copy_from_slice(&checksum.to_le_bytes());
    }
    Some(file)
}

/// Returns the range of the checksum in a file whose arrays begin at `start`. Its bytes count as
/// zeros in the checksum itself.
fn checksum_place(header: &str, start: usize) -> Option<Range<usize>> {
    let header: Value = serde_json::from_str(header).ok()?;
    let offset = header["checksum"]["data_offsets"][0].as_u64()?;
    let start = usize::try_from(offset).ok()?.checked_add(start)?;
    Some(start..start.checked_add(4)?)
}

/// Splits a checkpoint into its parts, with zeros for the checksum.
pub fn parts(file: &[u8]) -> Option<(String, String, Vec<u8>)> {
    let length = u64::from_le_bytes(*file.first_chunk()?);
    let (header, data) = file[8..].split_at_checked(usize::try_from(length).ok()?)?;
    let mut header: Value = serde_json::from_slice(header).ok()?;
    let metadata = header.as_object_mut()?.remove("__metadata__")?;
    let envelope = metadata["covers"].as_str()?.to_owned();
    let offset = header["checksum"]["data_offsets"][0].as_u64()?;
    let mut data = data.to_vec();
    data[offset as usize..][..4].fill(0);
    Some((envelope, header.to_string(), data))
}
