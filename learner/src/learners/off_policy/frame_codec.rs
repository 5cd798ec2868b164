//! Lossless compression of the pictures of a replay buffer in a checkpoint.
//!
//! Most pixels of a table do not change from one picture to the next. So every picture is written
//! as its difference (xor) from the one before it, the first one as differences of neighbouring
//! pixels, and runs of zeros as their lengths.

/// Zero bytes that end a run of non-zero bytes in the run-length code of [`encode_runs`].
// A shorter gap costs less than the two lengths of another run.
const GAP: [u8; 4] = [0; 4];

/// Lossless codec for the pictures of an episode, which are compressed together, by their sizes.
#[derive(Clone, Copy, Debug)]
pub struct EpisodePictureCodec {
    /// Size of one picture in bytes.
    pub picture_bytes: usize,
    /// Size of one pixel in bytes.
    pub pixel_bytes: usize,
}

impl EpisodePictureCodec {
    /// Compresses the pictures of an episode and appends them to `out`; `pictures` is overwritten.
    pub fn pack(self, pictures: &mut [u8], out: &mut Vec<u8>) {
        let (first, _) = pictures.split_at_mut(self.picture_bytes.min(pictures.len()));
        let first = first.len();
        // from the last picture to the first, so that the one before is not yet overwritten
        for start in (first..pictures.len()).step_by(self.picture_bytes.max(1)).rev() {
            let (before, own) = pictures.split_at_mut(start);
            xor_with(own, &before[start - self.picture_bytes..]);
        }
        for i in (self.pixel_bytes..first).rev() {
            pictures[i] ^= pictures[i - self.pixel_bytes];
        }
        encode_runs(pictures, out);
    }

    /// Decompresses the pictures of an episode from the front of `packed` into `pictures` and
    /// returns the rest of `packed`; `None` if the data does not fit.
    pub fn unpack<'a>(self, packed: &'a [u8], pictures: &mut [u8]) -> Option<&'a [u8]> {
        let rest = decode_runs(packed, pictures)?;
        let first = self.picture_bytes.min(pictures.len());
        for i in self.pixel_bytes..first {
            pictures[i] ^= pictures[i - self.pixel_bytes];
        }
        for start in (first..pictures.len()).step_by(self.picture_bytes.max(1)) {
            let (before, own) = pictures.split_at_mut(start);
            xor_with(own, &before[start - self.picture_bytes..]);
        }
        Some(rest)
    }
}

fn xor_with(picture: &mut [u8], other: &[u8]) {
    picture.iter_mut().zip(other).for_each(|(own, byte)| *own ^= byte);
}

/// Writes `bytes` in a run-length code: each run is a number of zeros, a number of other bytes, and
/// these bytes.
fn encode_runs(mut bytes: &[u8], out: &mut Vec<u8>) {
    while !bytes.is_empty() {
        let (zeros, rest) = bytes.split_at(leading_zeros(bytes));
        let other = rest.windows(GAP.len()).position(|window| window == GAP);
        let (other, rest) = rest.split_at(other.unwrap_or(rest.len()));
        write_length(zeros.len(), out);
        write_length(other.len(), out);
        out.extend_from_slice(other);
        bytes = rest;
    }
}

fn leading_zeros(bytes: &[u8]) -> usize {
    // blocks of zeros are skipped as a whole, which is faster than byte by byte
    const BLOCK: usize = 64;
    let blocks = bytes.chunks_exact(BLOCK);
    let blocks = blocks.take_while(|block| block.iter().fold(0, |all, byte| all | byte) == 0);
    let whole = BLOCK * blocks.count();
    whole + bytes[whole..].iter().take_while(|&&byte| byte == 0).count()
}

fn decode_runs<'a>(mut packed: &'a [u8], mut out: &mut [u8]) -> Option<&'a [u8]> {
    while !out.is_empty() {
        let zeros = read_length(&mut packed)?;
        let other = read_length(&mut packed)?;
        let (to_zeros, rest) = out.split_at_mut_checked(zeros)?;
        let (to_other, rest) = rest.split_at_mut_checked(other)?;
        let (from, behind) = packed.split_at_checked(other)?;
        to_zeros.fill(0);
        to_other.copy_from_slice(from);
        // two zero lengths make no progress, so a damaged file could repeat them for ever
        if zeros + other == 0 {
            return None;
        }
        (packed, out) = (behind, rest);
    }
    Some(packed)
}

/// Writes a length as LEB128: seven bits in each byte, the lowest first; the highest bit marks that
/// more bytes follow.
fn write_length(mut length: usize, out: &mut Vec<u8>) {
    while length >= 0x80 {
        out.push(length as u8 | 0x80);
        length >>= 7;
    }
    out.push(length as u8);
}

fn read_length(packed: &mut &[u8]) -> Option<usize> {
    let mut length = 0;
    for shift in (0..usize::BITS).step_by(7) {
        let (&byte, rest) = packed.split_first()?;
        *packed = rest;
        length |= usize::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Some(length);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn packed(frames: EpisodePictureCodec, pictures: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        frames.pack(&mut pictures.to_vec(), &mut out);
        out
    }

    fn back(frames: EpisodePictureCodec, packed: &[u8], len: usize) -> Option<(Vec<u8>, usize)> {
        let mut pictures = vec![7; len];
        let rest = frames.unpack(packed, &mut pictures)?;
        Some((pictures, rest.len()))
    }

    #[test]
    fn a_table_on_which_little_moves_is_small() {
        let frames = EpisodePictureCodec { picture_bytes: 3 * 64 * 64, pixel_bytes: 3 };
        let mut pictures = [90, 80, 70].repeat(64 * 64 * 51);
        for (t, picture) in pictures.chunks_mut(frames.picture_bytes).enumerate() {
            picture[300 + 3 * t..][..30].fill(200);
        }
        let packed = packed(frames, &pictures);
        assert!(packed.len() * 100 < pictures.len(), "{}", packed.len());
        let again = back(frames, &packed, pictures.len());
        assert!(again == Some((pictures, 0)));
    }

    #[test]
    fn what_does_not_fit_is_noticed() {
        let frames = EpisodePictureCodec { picture_bytes: 4, pixel_bytes: 1 };
        let packed = packed(frames, &[5; 12]);
        for cut in 0..packed.len() {
            assert_eq!(back(frames, &packed[..cut], 12), None, "{cut} bytes");
        }
        assert_eq!(back(frames, &packed, 11), None);
        assert_eq!(back(frames, &[0, 0], 12), None);
        assert_eq!(back(frames, &[0x80; 20], 12), None);
    }

    #[test]
    fn every_picture_comes_back() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..500 {
            let frames = EpisodePictureCodec {
                picture_bytes: rng.random_range(0..50),
                pixel_bytes: rng.random_range(1..5),
            };
            let zeros = rng.random_range(0..10);
            let mut byte = || {
                if rng.random_range(0..10) < zeros { 0 } else { rng.random_range(0..=255) }
            };
            let bytes: Vec<u8> = (0..200).map(|_| byte()).collect();
            let bytes = &bytes[..rng.random_range(0..=200)];
            let mut packed = packed(frames, bytes);
            packed.extend([1, 2, 3]);
            assert_eq!(back(frames, &packed, bytes.len()), Some((bytes.to_vec(), 3)));
        }
    }
}
