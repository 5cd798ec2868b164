//! Arm that is built when it is first used.

use std::borrow::Cow;
use std::sync::OnceLock;

use glam::DVec3;

use super::arm::Arm;
use crate::actuation::{HandActuation, NamedJointPositions};
use crate::embodiment_spec::{EmbodimentSceneParts, EmbodimentSpec};
use crate::error::EnvError;

/// Embodiment of an arm that is built when it is first used.
pub(crate) struct LazyArm {
    name: Cow<'static, str>,
    build: fn(&str) -> Result<Arm, EnvError>,
    arm: OnceLock<Arm>,
}

impl LazyArm {
    /// Creates the embodiment called `name`, whose arm `build` makes from that name.
    pub const fn new(name: Cow<'static, str>, build: fn(&str) -> Result<Arm, EnvError>) -> Self {
        Self { name, build, arm: OnceLock::new() }
    }

    /// Returns the arm, built on first use.
    ///
    /// # Errors
    /// Those of building it; the next call tries again.
    pub fn arm(&self) -> Result<&Arm, EnvError> {
        if let Some(arm) = self.arm.get() {
            return Ok(arm);
        }
        let arm = (self.build)(&self.name)?;
        Ok(self.arm.get_or_init(|| arm))
    }
}

impl EmbodimentSpec for LazyArm {
    fn name(&self) -> &str {
        &self.name
    }

    fn parts(&self) -> Result<EmbodimentSceneParts, EnvError> {
        self.arm()?.parts()
    }

    fn initial_joint_positions(&self, hand_target: DVec3) -> Result<NamedJointPositions, EnvError> {
        self.arm()?.initial_joint_positions(hand_target)
    }

    fn actuation(&self) -> Result<HandActuation, EnvError> {
        self.arm()?.actuation()
    }
}
