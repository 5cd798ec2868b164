//! Settings of the recogniser.

use serde::{Deserialize, Serialize};

use crate::error::{EvidenceError, Result};

/// Settings of a [`Recogniser`](crate::Recogniser) of task groups: memory, tests and their levels.
///
/// In a file, a field that is missing has its default, and one that does not exist is an error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecogniserSettings {
    /// Number of random filters that describe an image, at least 1.
    pub filters: usize,
    /// Number of episodes remembered for each policy, the latest that it trained on; at least
    /// `min_episodes`.
    pub memory: usize,
    /// Largest number of policies, merged ones included, at least 1. Beyond it a rollout that fits
    /// no policy trains the most similar one, which then serves several task groups.
    pub max_policies: usize,
    /// Number of episodes that a test of a policy needs, both in the rollout and in the policy's
    /// memory; at least 4.
    pub min_episodes: usize,
    /// Significance level of the screening test of a rollout, in `(0, 1)`: the share of rollouts of
    /// a known task group that are doubted, over all sources of evidence together. It is compared
    /// with the exact p-value.
    pub doubt: f64,
    /// Significance level of the final rejection of a policy, in `(0, doubt]`: the nominal rate of
    /// false alarms over all sources of evidence together. It is compared with the fitted tail's
    /// p-value.
    pub level: f64,
    /// Significance level of the changepoint test, over all places where a rollout may be cut, in
    /// `(0, 1)` and at least `1 / (1 + 4 permutations)`.
    pub cut: f64,
    /// Least ratio of the distance of images or vectors to its mean over random splits for a
    /// rejection, at least 1: less counts as drift. The excess over 1 is 2.5 times as large
    /// for a policy that was away, and 4 times if all others are far.
    pub min_ratio: f64,
    /// Least relative change of motion (response of the vector to actions) or of the reward
    /// gradient for it to count, above 0. The distance of motion must also be at least three times
    /// the mean over random splits, and that of the reward gradient twice.
    pub min_motion: f64,
    /// Least lost share of a policy's gain in return for returns to count, in `(0, 1]`.
    pub min_loss: f64,
    /// Number of random splits of the pooled episodes in a screening test, at least 20; the final
    /// test takes three times as many.
    pub permutations: usize,
}

impl Default for RecogniserSettings {
    fn default() -> Self {
        Self {
            filters: 32,
            memory: 40,
            max_policies: 1000,
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
    /// Checks that every setting of the recogniser is in its range.
    ///
    /// # Errors
    /// The first setting outside its range, with its value.
    pub fn check(&self) -> Result<()> {
        let size = |name, value: usize, least: usize, expected| {
            check_range(name, value as f64, value >= least, expected)
        };
        size("filters", self.filters, 1, "at least 1")?;
        size("max_policies", self.max_policies, 1, "at least 1")?;
        size("min_episodes", self.min_episodes, 4, "at least 4")?;
        size("memory", self.memory, self.min_episodes, "at least min_episodes")?;
        size("permutations", self.permutations, 20, "at least 20")?;
        let smallest = |splits: usize| 1.0 / (1.0 + splits as f64 * self.permutations as f64);
        let of_test = "at least 1 / (1 + permutations), the smallest exact p-value";
        let of_changepoint = "at least 1 / (1 + 4 permutations), the smallest exact p-value";
        for (name, value, least, reachable) in [
            ("doubt", self.doubt, smallest(1), of_test),
            ("cut", self.cut, smallest(CHANGEPOINT_ORDERS), of_changepoint),
        ] {
            let is_probability = value > 0.0 && value < 1.0;
            check_range(name, value, is_probability, "a probability above 0 and below 1")?;
            check_range(name, value, value >= least, reachable)?;
        }
        let Self { level, min_ratio, min_motion, min_loss, .. } = *self;
        let below_doubt = level > 0.0 && level <= self.doubt;
        check_range("level", level, below_doubt, "a probability above 0 and at most doubt")?;
        let is_ratio = (1.0..f64::INFINITY).contains(&min_ratio);
        check_range("min_ratio", min_ratio, is_ratio, "a finite number, at least 1")?;
        let is_positive = min_motion > 0.0 && min_motion.is_finite();
        check_range("min_motion", min_motion, is_positive, "a finite share above 0")?;
        let is_share = min_loss > 0.0 && min_loss <= 1.0;
        check_range("min_loss", min_loss, is_share, "a share above 0 and at most 1")
    }
}

/// Number of random orders of a changepoint test for each random split of a screening test.
// Energy distances of an order are cheap: one pass over the pairs of episodes.
pub(crate) const CHANGEPOINT_ORDERS: usize = 4;

/// Returns an error for a setting that is not `inside` its range, which `expected` says in words.
fn check_range(name: &'static str, value: f64, inside: bool, expected: &'static str) -> Result<()> {
    if inside { Ok(()) } else { Err(EvidenceError::InvalidSetting { name, value, expected }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_survive_a_file_and_ranges_are_checked() {
        let settings =
            RecogniserSettings { memory: 33, level: 3e-5, ..RecogniserSettings::default() };
        let text = serde_json::to_string(&settings).unwrap();
        assert_eq!(serde_json::from_str::<RecogniserSettings>(&text).unwrap(), settings);
        assert!(serde_json::from_str::<RecogniserSettings>(r#"{"leval": 1}"#).is_err());
        assert!(settings.check().is_ok());
        let wrong = RecogniserSettings { min_loss: f64::NAN, ..settings };
        let message = wrong.check().unwrap_err().to_string();
        assert!(message.starts_with("setting `min_loss` is NaN"), "{message}");
        let coarse = RecogniserSettings { permutations: 20, ..settings };
        let unreachable_cut = RecogniserSettings { cut: 0.002, ..settings };
        for (case, name) in [(coarse, "`doubt`"), (unreachable_cut, "`cut`")] {
            let refusal = case.check().unwrap_err().to_string();
            let says = refusal.contains(name) && refusal.contains("smallest exact");
            assert!(says, "{refusal}");
        }
    }
}
