//! Settings of the recogniser.

use serde::{Deserialize, Serialize};

use crate::error::EvidenceError;

/// Settings of a [`Recogniser`](crate::Recogniser).
///
/// In a file, a field that is missing has its default, and one that does not exist is an error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecogniserSettings {
    /// Random filters that describe a picture, at least 1.
    pub filters: usize,
    /// Episodes remembered for each policy, the latest on which it learnt; at least `min_episodes`.
    pub memory: usize,
    /// Episodes that a rollout must show, and a policy remember, to be tested; at least 4.
    pub min_episodes: usize,
    /// Level of the first look, in `(0, 1)`: the share of rollouts of a known group that are
    /// doubted, over all sources together. Compared with the exact p-value.
    pub doubt: f64,
    /// Level of a refusal, in `(0, doubt]`: the nominal rate of false alarms over all sources
    /// together. Compared with the tail's p-value.
    pub level: f64,
    /// Level in `(0, 1)` at which a doubted rollout is taken to show two groups, over all places
    /// where it may be cut.
    pub cut: f64,
    /// Least ratio of a picture's or a vector's distance to its mean over random splits for a
    /// refusal, at least 1: less counts as drift.
    pub min_ratio: f64,
    /// Least change of how vectors answer to actions, as a share, for motion to count; above 0.
    pub min_motion: f64,
    /// Least share of what a policy has learnt to earn that must be lost for earnings to count, in
    /// `(0, 1]`.
    pub min_loss: f64,
    /// Random splits of the first look, at least 20; the second one takes four times as many.
    pub permutations: usize,
}

impl Default for RecogniserSettings {
    fn default() -> Self {
        Self {
            filters: 32,
            memory: 40,
            min_episodes: 4,
            doubt: 0.02,
            level: 1e-4,
            cut: 0.01,
            min_ratio: 1.2,
            min_motion: 0.25,
            min_loss: 0.3,
            permutations: 100,
        }
    }
}

impl RecogniserSettings {
    /// Checks every range.
    ///
    /// # Errors
    /// The first setting outside its range, with its value.
    pub fn check(&self) -> Result<(), EvidenceError> {
        let open = |level: f64| level > 0.0 && level < 1.0;
        let ratio = |ratio: f64| (1.0..f64::INFINITY).contains(&ratio);
        let checks = [
            (
                "filters",
                self.filters as f64,
                self.filters > 0,
                "at least 1",
            ),
            (
                "min_episodes",
                self.min_episodes as f64,
                self.min_episodes >= 4,
                "at least 4",
            ),
            (
                "memory",
                self.memory as f64,
                self.memory >= self.min_episodes,
                "at least min_episodes",
            ),
            (
                "permutations",
                self.permutations as f64,
                self.permutations >= 20,
                "at least 20",
            ),
            (
                "doubt",
                self.doubt,
                open(self.doubt),
                "a probability above 0 and below 1",
            ),
            (
                "doubt",
                self.doubt,
                self.doubt * (1.0 + self.permutations as f64) >= 1.0,
                "at least 1 / (1 + permutations), the smallest exact p-value",
            ),
            (
                "level",
                self.level,
                self.level > 0.0 && self.level <= self.doubt,
                "a probability above 0 and at most doubt",
            ),
            (
                "cut",
                self.cut,
                open(self.cut),
                "a probability above 0 and below 1",
            ),
            (
                "min_ratio",
                self.min_ratio,
                ratio(self.min_ratio),
                "a finite number, at least 1",
            ),
            (
                "min_motion",
                self.min_motion,
                self.min_motion > 0.0,
                "a share above 0",
            ),
            (
                "min_loss",
                self.min_loss,
                self.min_loss > 0.0 && self.min_loss <= 1.0,
                "a share above 0 and at most 1",
            ),
        ];
        match checks.into_iter().find(|(_, _, holds, _)| !holds) {
            None => Ok(()),
            Some((name, value, _, expected)) => Err(EvidenceError::Setting {
                name,
                value,
                expected,
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_survive_a_file_and_ranges_are_checked() {
        let settings = RecogniserSettings {
            memory: 33,
            level: 3e-5,
            ..RecogniserSettings::default()
        };
        let text = serde_json::to_string(&settings).unwrap();
        assert_eq!(
            serde_json::from_str::<RecogniserSettings>(&text).unwrap(),
            settings
        );
        assert!(serde_json::from_str::<RecogniserSettings>(r#"{"leval": 1}"#).is_err());
        assert!(settings.check().is_ok());
        let wrong = RecogniserSettings {
            min_loss: f64::NAN,
            ..settings
        };
        let message = wrong.check().unwrap_err().to_string();
        assert!(
            message.starts_with("setting `min_loss` is NaN"),
            "{message}"
        );
        let coarse = RecogniserSettings {
            permutations: 20,
            ..settings
        };
        assert!(
            coarse
                .check()
                .unwrap_err()
                .to_string()
                .contains("smallest exact")
        );
    }
}
