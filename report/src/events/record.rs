//! Records in the framing of TensorFlow's event files.
//!
//! A record is its length (u64), the length's checksum (u32), the bytes, and their checksum (u32),
//! all little-endian (tensorflow/core/lib/io/record_writer.h).

use crc::{CRC_32_ISCSI, Crc};

/// CRC32C (Castagnoli).
const CHECKSUM: Crc<u32> = Crc::<u32>::new(&CRC_32_ISCSI);
/// What is added to a rotated checksum, so that a checksum of checksums is none of the same kind.
const MASK: u32 = 0xa282_ead8;

fn masked(bytes: &[u8]) -> u32 {
    CHECKSUM.checksum(bytes).rotate_right(15).wrapping_add(MASK)
}

/// Adds a record to the bytes of a file.
pub(super) fn append(file: &mut Vec<u8>, bytes: &[u8]) {
    let length = (bytes.len() as u64).to_le_bytes();
    file.extend(length);
    file.extend(masked(&length).to_le_bytes());
    file.extend(bytes);
    file.extend(masked(bytes).to_le_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first record of every event file that TensorFlow writes has 24 bytes, and this checksum
    /// of its length.
    #[test]
    fn a_record_is_framed() {
        let mut file = Vec::new();
        append(&mut file, &[7; 24]);
        assert_eq!(file.len(), 8 + 4 + 24 + 4);
        assert_eq!(file[..12], [24, 0, 0, 0, 0, 0, 0, 0, 0xa3, 0x7f, 0x4b, 0x22]);
        assert_eq!(file[36..], masked(&[7; 24]).to_le_bytes());
    }
}
