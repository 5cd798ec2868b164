//! Pictures that were described lately.

use std::collections::VecDeque;

/// Pictures that are kept.
const MOST: usize = 64;

/// The latest pictures and their descriptions: a decision and the memory that follows it look at
/// the same ones.
#[derive(Clone, Debug, Default)]
pub struct Album(VecDeque<(Vec<u8>, Vec<f32>)>);

impl Album {
    /// The description of a picture, if it is kept.
    pub(crate) fn find(&self, image: &[u8]) -> Option<&[f32]> {
        let mut latest = self.0.iter().rev();
        let found = latest.find(|(kept, _)| kept == image);
        found.map(|(_, described)| described.as_slice())
    }

    /// Keeps a description; the oldest one goes.
    pub(crate) fn keep(&mut self, image: &[u8], described: &[f32]) {
        if self.find(image).is_some() {
            return;
        }
        if self.0.len() == MOST {
            self.0.pop_front();
        }
        self.0.push_back((image.to_vec(), described.to_vec()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_pictures_are_found() {
        let mut album = Album::default();
        for image in 0..=MOST as u8 {
            album.keep(&[image; 4], &[f32::from(image)]);
            album.keep(&[image; 4], &[-1.0]);
        }
        assert_eq!(album.find(&[0; 4]), None);
        assert_eq!(album.find(&[1; 4]), Some(&[1.0][..]));
        assert_eq!(album.find(&[MOST as u8; 4]), Some(&[MOST as f32][..]));
    }
}
