//! Settings that convert actions to motion, and the length of an episode.

use serde::{Deserialize, Serialize};

use crate::error::{EnvError, require};

/// Number of physics steps of 2.5 ms in one control step of 12.5 ms, as in Meta-World.
pub const PHYSICS_STEPS_PER_CONTROL_STEP: usize = 5;
/// Duration of a physics step (seconds), which every scene has.
pub(crate) const PHYSICS_STEP: f64 = 0.0025;
/// Duration of a control step (seconds).
const CONTROL_STEP: f64 = PHYSICS_STEPS_PER_CONTROL_STEP as f64 * PHYSICS_STEP;
/// Largest displacement of the hand's target by a full action (metres), more than the table's half
/// width.
const MAX_DISPLACEMENT: f64 = 1.0;

/// Action scale, action repeat and episode length of an environment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControlSettings {
    /// Number of control steps (12.5 ms each) that one action is held for.
    pub action_repeat: usize,
    /// Displacement of the hand's target by a full action, per decision (metres).
    pub displacement: f64,
    /// Number of control steps (12.5 ms each) in an episode; a multiple of `action_repeat`.
    pub horizon: usize,
}

impl Default for ControlSettings {
    fn default() -> Self {
        // decisions at 8 Hz; Meta-World's 500 control steps then are an episode of 50 decisions
        Self { action_repeat: 10, displacement: 0.04, horizon: 500 }
    }
}

impl ControlSettings {
    /// Returns the duration of a decision (seconds of simulated time).
    pub fn decision_seconds(&self) -> f64 {
        self.action_repeat as f64 * CONTROL_STEP
    }

    /// Returns Meta-World's settings: an action is held for one control step and moves the target
    /// by 1 cm.
    pub fn meta_world() -> Self {
        Self { action_repeat: 1, displacement: 0.01, horizon: 500 }
    }

    /// Returns the number of decisions in an episode; 0 if the action repeat is 0, which
    /// [`ControlSettings::check`] rejects.
    pub fn decisions_per_episode(&self) -> usize {
        self.horizon.checked_div(self.action_repeat).unwrap_or(0)
    }

    /// Rejects an action repeat, a displacement or a horizon that is out of range.
    ///
    /// # Errors
    /// [`EnvError::InvalidSetting`].
    pub fn check(&self) -> Result<(), EnvError> {
        // an episode that ends within a decision would have a shorter last one
        let whole = self.horizon > 0 && self.horizon.checked_rem(self.action_repeat) == Some(0);
        let value = format!("{} with action repeat {}", self.horizon, self.action_repeat);
        let expected = "a positive multiple of the action repeat";
        require(whole, "horizon", &value, expected)?;
        let in_range = self.displacement > 0.0 && self.displacement <= MAX_DISPLACEMENT;
        let expected_displacement = "a length in metres above 0 and at most 1";
        require(in_range, "displacement", &self.displacement, expected_displacement)
    }
}

/// Returns the action of one environment with its components clipped to `[-1, 1]`.
pub(crate) fn clip_action<const N: usize>(action: &[f32; N]) -> Result<[f64; N], EnvError> {
    check_action(action)?;
    Ok(action.map(|value| f64::from(value.clamp(-1.0, 1.0))))
}

/// Rejects an action with components that are NaN or infinite.
pub(crate) fn check_action(action: &[f32]) -> Result<(), EnvError> {
    match action.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(component) => Err(EnvError::NonFiniteAction { component, value: action[component] }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decisions_of_settings_that_are_refused_are_none() {
        let never = ControlSettings { action_repeat: 0, ..ControlSettings::default() };
        assert_eq!(never.decisions_per_episode(), 0);
        let message = never.check().unwrap_err().to_string();
        assert!(message.contains("500 with action repeat 0"), "{message}");
        assert_eq!(ControlSettings::default().decisions_per_episode(), 50);
        assert_eq!(ControlSettings::meta_world().decisions_per_episode(), 500);
    }
}
