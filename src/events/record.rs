//! Records in the framing of TensorFlow's event files.
//!
//! A record is its length (u64), the length's checksum (u32), the bytes, and their checksum (u32),
//! all little-endian (tensorflow/core/lib/io/record_writer.h).

/// The polynomial of CRC32C (Castagnoli), bits reversed.
const POLYNOMIAL: u32 = 0x82f6_3b78;
/// What is added to a rotated checksum, so that a checksum of checksums is none of the same kind.
const MASK: u32 = 0xa282_ead8;

/// The checksum of every byte.
const TABLE: [u32; 256] = {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut remainder = byte as u32;
        let mut bit = 0;
        while bit < 8 {
            let odd = remainder & 1 == 1;
            remainder = (remainder >> 1) ^ if odd { POLYNOMIAL } else { 0 };
            bit += 1;
        }
        table[byte] = remainder;
        byte += 1;
    }
    table
};

fn crc32c(bytes: &[u8]) -> u32 {
    let step = |crc: u32, &byte: &u8| (crc >> 8) ^ TABLE[usize::from(crc as u8 ^ byte)];
    !bytes.iter().fold(!0, step)
}

fn masked(bytes: &[u8]) -> u32 {
    crc32c(bytes).rotate_right(15).wrapping_add(MASK)
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

    /// RFC 3720, appendix B.4, and the string that CRC catalogues check with.
    #[test]
    fn checksums_are_those_of_the_standard() {
        assert_eq!(crc32c(&[0; 32]), 0x8a91_36aa);
        assert_eq!(crc32c(&[0xff; 32]), 0x62a8_ab43);
        assert_eq!(crc32c(b"123456789"), 0xe306_9283);
    }

    /// The first record of every event file that TensorFlow writes has 24 bytes, and this checksum
    /// of its length.
    #[test]
    fn a_record_is_framed() {
        let mut file = Vec::new();
        append(&mut file, &[7; 24]);
        assert_eq!(file.len(), 8 + 4 + 24 + 4);
        assert_eq!(
            file[..12],
            [24, 0, 0, 0, 0, 0, 0, 0, 0xa3, 0x7f, 0x4b, 0x22]
        );
        assert_eq!(file[36..], masked(&[7; 24]).to_le_bytes());
    }
}
