//! The newest picture of a run, for who looks on.

use std::sync::{Arc, Mutex};

use envs::RGB;
use rl::{EnvSpec, Observations};

use crate::sheet::Picture;

/// Where a run leaves what its first environment shows. Clones are one and the same place.
#[derive(Clone, Debug, Default)]
pub struct Glimpse(Arc<Mutex<Option<Picture>>>);

impl Glimpse {
    /// Leaves the picture of the first environment. Nobody is waited for: a picture that cannot be
    /// left at once is left out.
    pub(crate) fn leave(&self, spec: &EnvSpec, observations: &Observations) {
        let [height, width, channels] = spec.image;
        let pixels = observations.images[..spec.image_len()].chunks_exact(channels);
        if let Ok(mut place) = self.0.try_lock() {
            *place = Some(Picture {
                width,
                height,
                rgb: pixels.flat_map(|pixel| &pixel[..RGB]).copied().collect(),
            });
        }
    }

    /// The newest picture.
    pub fn look(&self) -> Option<Picture> {
        self.0.lock().ok()?.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_picture_of_now_is_left_and_not_that_of_the_beginning() {
        let spec =
            EnvSpec { num_envs: 2, image: [1, 2, 6], vector: Vec::new(), action: Vec::new() };
        let mut observations = Observations::new(&spec);
        observations.images = (0..24).collect();
        let glimpse = Glimpse::default();
        assert_eq!(glimpse.look(), None);
        glimpse.clone().leave(&spec, &observations);
        let picture = glimpse.look().unwrap();
        assert_eq!((picture.width, picture.height), (2, 1));
        assert_eq!(picture.rgb, [0, 1, 2, 6, 7, 8]);
    }
}
