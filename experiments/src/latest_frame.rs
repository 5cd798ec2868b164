//! Latest frame of a run, for viewers.

use std::sync::{Arc, Mutex};

use envs::RGB_CHANNELS;
use rl::{EnvSpec, Observations};

use crate::sheet::Picture;

/// Shared slot for the latest image of a run's first environment. Clones share one slot.
#[derive(Clone, Debug, Default)]
pub struct LatestFrame(Arc<Mutex<Option<Picture>>>);

impl LatestFrame {
    /// Stores the image of the first environment, or drops it while a viewer holds the slot.
    pub(crate) fn update(&self, spec: &EnvSpec, observations: &Observations) {
        let [height, width, channels] = spec.image_shape;
        let pixels = observations.images[..spec.image_len()].chunks_exact(channels);
        // training must never wait for a viewer
        if let Ok(mut slot) = self.0.try_lock() {
            *slot = Some(Picture {
                width,
                height,
                rgb: pixels.flat_map(|pixel| &pixel[..RGB_CHANNELS]).copied().collect(),
            });
        }
    }

    /// Returns the latest image of the run's first environment; `None` before the first step.
    pub fn newest(&self) -> Option<Picture> {
        self.0.lock().ok()?.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_picture_of_now_is_left_and_not_that_of_the_beginning() {
        let spec = EnvSpec {
            num_envs: 2,
            image_shape: [1, 2, 6],
            vector_irreps: Vec::new(),
            action_irreps: Vec::new(),
            choices: vec![],
        };
        let mut observations = Observations::new(&spec);
        observations.images = (0..24).collect();
        let latest_frame = LatestFrame::default();
        assert_eq!(latest_frame.newest(), None);
        latest_frame.clone().update(&spec, &observations);
        let picture = latest_frame.newest().unwrap();
        assert_eq!((picture.width, picture.height), (2, 1));
        assert_eq!(picture.rgb, [0, 1, 2, 6, 7, 8]);
    }
}
