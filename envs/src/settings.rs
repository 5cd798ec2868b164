//! Settings of a vector environment.

use serde::{Deserialize, Serialize};

use crate::camera::{Camera, ExtraViews};
use crate::control::ControlSettings;
use crate::embodiment::Embodiment;
use crate::error::{EnvError, require};
use crate::layout::Layout;
use crate::randomisation::VisualDomainRandomisation;

/// Largest number of worker threads; a typing error in a file must not start a million.
pub const MAX_THREADS: usize = 1024;

/// Settings of a [`VecEnv`](crate::VecEnv).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VecEnvSettings {
    /// Number of environments, N, that step together.
    pub num_envs: usize,
    /// Number of worker threads, 1 to 1024; results do not depend on this.
    pub threads: usize,
    /// Layout of the scenes. [`Layout::MetaWorld`] goes with [`ControlSettings::meta_world`].
    pub layout: Layout,
    /// Embodiment that acts in the environments, an arm or a hand alone.
    pub embodiment: Embodiment,
    /// Camera above the table, with its light and the gripper's mark.
    pub camera: Camera,
    /// Action scale, action repeat and episode length.
    pub control: ControlSettings,
    /// Domain randomisation of the pictures; `None` for perfect pictures.
    #[serde(default)]
    pub randomisation: Option<VisualDomainRandomisation>,
    /// Seed of the random placements, variants and camera errors of all environments.
    pub seed: u64,
}

impl Default for VecEnvSettings {
    fn default() -> Self {
        Self {
            num_envs: 20,
            threads: 2,
            layout: Layout::default(),
            embodiment: Embodiment::default(),
            camera: Camera::default(),
            control: ControlSettings::default(),
            seed: 0,
            randomisation: None,
        }
    }
}

const OCCLUDING_ARM: &str = "an arm with servos, kinova_gen3 or the URDF of one, since \
`camera.arm_occlusion` is above 0";

const FIRST_PICTURE: &str = "the first picture if pictures are randomised: camera errors apply to \
whole pictures, so close-ups would be without them";

impl VecEnvSettings {
    /// Returns the number of bytes of one environment's observed image: size x size x number of
    /// channels.
    pub fn image_len(&self) -> usize {
        self.camera.size * self.camera.size * self.camera.extra_views.num_total_channels()
    }

    /// Returns the settings with the pictures that evaluations show: not randomised, and with
    /// nothing that the arm hides.
    pub fn for_evaluation(self) -> Self {
        let camera = Camera { arm_occlusion: 0.0, ..self.camera };
        Self { randomisation: None, camera, ..self }
    }

    /// Rejects settings of environments that are out of range.
    ///
    /// # Errors
    /// [`EnvError::InvalidSetting`]; with [`Camera::arm_occlusion`] those of [`Embodiment::arm`].
    pub fn check(&self) -> Result<(), EnvError> {
        require(self.num_envs > 0, "num_envs", &self.num_envs, "at least 1")?;
        // more threads than environments are allowed: the rest has no work
        let few = (1..=MAX_THREADS).contains(&self.threads);
        require(few, "threads", &self.threads, "1 to 1024")?;
        self.camera.check()?;
        if self.camera.arm_occlusion > 0.0 {
            self.embodiment.arm().map_err(|error| match error {
                EnvError::InvalidSetting { name: name @ "embodiment", value, .. } => {
                    EnvError::InvalidSetting { name, value, expected: OCCLUDING_ARM }
                }
                other => other,
            })?;
        }
        if let Some(amounts) = &self.randomisation {
            amounts.check(&self.camera)?;
            // a close-up is cut out before camera errors are added
            let first = self.camera.extra_views == ExtraViews::First;
            require(first, "camera.beside", &"a close-up", FIRST_PICTURE)?;
        }
        self.control.check()
    }
}
