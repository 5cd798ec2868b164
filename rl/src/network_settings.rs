//! Settings of the actor-critic network.

use serde::{Deserialize, Serialize};

use crate::error::RlError;

/// Sizes and initial values of [`crate::ActorCritic`]. The default is the network measured for 48 x 48 pixels.
///
/// In a file, a field that is missing has its default, and one that does not exist is an error.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetworkSettings {
    /// Regular fields after each 4 x 4 convolution of stride 2, each at least 1; every convolution halves the image.
    pub conv_fields: Vec<usize>,
    /// Regular fields of the image's feature vector, at least 1.
    pub top_fields: usize,
    /// Regular fields of the observation vector's features, at least 1.
    pub vector_fields: usize,
    /// Regular fields of the actor's hidden layer, at least 1.
    pub actor_fields: usize,
    /// Channels of the critic's hidden layer, at least 1.
    pub critic_width: usize,
    /// Gain of the actor's last layer when it is drawn, above 0; small, so that mean actions start near zero.
    pub action_gain: f32,
    /// Gain of the critic's last layer when it is drawn, above 0.
    pub value_gain: f32,
    /// Initial logarithm of every action component's standard deviation.
    pub log_std: f32,
}

impl Default for NetworkSettings {
    fn default() -> Self {
        Self {
            conv_fields: vec![4, 8, 16, 16],
            top_fields: 32,
            vector_fields: 32,
            actor_fields: 32,
            critic_width: 64,
            action_gain: 0.01,
            value_gain: 1.0,
            log_std: -0.5,
        }
    }
}

impl NetworkSettings {
    /// The number of which the image's height and width must be multiples: 2 to the power of the number of
    /// convolutions.
    pub fn image_multiple(&self) -> usize {
        1 << self.conv_fields.len().min(31)
    }

    /// Refuses values outside their ranges.
    ///
    /// # Errors
    /// [`RlError::Setting`] names the field, its value and its range.
    pub fn check(&self) -> Result<(), RlError> {
        let widths = [
            (
                "conv_fields",
                self.conv_fields.iter().copied().min().unwrap_or(0),
            ),
            ("top_fields", self.top_fields),
            ("vector_fields", self.vector_fields),
            ("actor_fields", self.actor_fields),
            ("critic_width", self.critic_width),
        ];
        for (name, width) in widths {
            require(
                name,
                width as f32,
                "at least 1 (a list must not be empty)",
                width > 0,
            )?;
        }
        for (name, value) in [
            ("action_gain", self.action_gain),
            ("value_gain", self.value_gain),
        ] {
            require(
                name,
                value,
                "a finite number above 0",
                value > 0.0 && value.is_finite(),
            )?;
        }
        require(
            "log_std",
            self.log_std,
            "a number in [-10, 2]",
            (-10.0..=2.0).contains(&self.log_std),
        )
    }
}

/// Refuses a setting that is not `allowed`.
pub(crate) fn require(
    name: &'static str,
    value: f32,
    expected: &'static str,
    allowed: bool,
) -> Result<(), RlError> {
    if allowed {
        Ok(())
    } else {
        Err(RlError::Setting {
            name,
            value: f64::from(value),
            expected,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_valid_and_zeros_are_refused() {
        let settings = NetworkSettings::default();
        assert!(settings.check().is_ok());
        assert_eq!(settings.image_multiple(), 16);
        for wrong in [
            NetworkSettings {
                conv_fields: vec![],
                ..settings.clone()
            },
            NetworkSettings {
                conv_fields: vec![4, 0],
                ..settings.clone()
            },
            NetworkSettings {
                action_gain: 0.0,
                ..settings.clone()
            },
            NetworkSettings {
                log_std: f32::NAN,
                ..settings.clone()
            },
        ] {
            assert!(matches!(wrong.check(), Err(RlError::Setting { .. })));
        }
    }

    #[test]
    fn settings_survive_a_file() {
        let settings = NetworkSettings {
            log_std: -0.3,
            ..NetworkSettings::default()
        };
        let text = serde_json::to_string(&settings).unwrap();
        assert_eq!(
            serde_json::from_str::<NetworkSettings>(&text).unwrap(),
            settings
        );
        let unknown = serde_json::from_str::<NetworkSettings>(r#"{"tops": 3}"#).unwrap_err();
        assert!(unknown.to_string().contains("unknown field `tops`"));
    }
}
