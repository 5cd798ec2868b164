//! Settings of the assigner.

use serde::{Deserialize, Serialize};

use crate::check::{at_least, within};
use crate::error::Result;
use crate::permutation::TestSize;

/// Rule by which the assigner decides if a rollout belongs to a policy's task group.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Rule {
    /// The paper's rule: `W1(O, B_j) <= threshold`, nearest policy first. It depends on the
    /// scale of the features.
    Fixed {
        /// Largest distance within a task group (`d_epsilon`), in the features' unit.
        threshold: f64,
    },
    /// A two-sample permutation test by whole episodes, with a second look before a new policy.
    /// Independent of the scale of the features.
    Calibrated(Calibrated),
}

impl Rule {
    /// The paper's rule with its threshold, `d_epsilon = 1.0`.
    pub const PAPER: Self = Self::Fixed { threshold: 1.0 };
}

impl Default for Rule {
    fn default() -> Self {
        Self::Calibrated(Calibrated::default())
    }
}

/// Settings of the calibrated rule, a two-sample permutation test.
///
/// The first look at a rollout accepts or doubts a group, the second one accepts or rejects it. The
/// crate's README explains the default values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Calibrated {
    /// Significance level of the first look, in `(0, 1)`: share of rollouts of a known group that
    /// ask for a second rollout. It is compared with the exact p-value.
    pub doubt: f64,
    /// Significance level of the second look, in `(0, doubt]`: the nominal rate of false alarms,
    /// which create a superfluous policy, among rollouts of a known group. It is compared with the
    /// p-value of the fitted tail.
    pub level: f64,
    /// Least ratio of `W1` to its mean over random splits for a rejection at the second look, at
    /// least 1: less counts as drift, however significant it is. Take 1 for features that vary in
    /// many directions, where all distances are alike.
    pub min_ratio: f64,
    /// Number of random splits of the pooled episodes at the first look, at least 20 and enough for
    /// an exact p-value of `doubt`: `1 / (1 + permutations) <= doubt`. The second look, which is
    /// rare and final, takes four times as many.
    pub permutations: usize,
    /// Least number of episodes of the rollout and of the buffer for a meaningful test, at least 4.
    pub min_episodes: usize,
    /// Number of episodes of each rollout that enter the test; more are sampled down. The second
    /// look pools two rollouts and takes twice as many.
    pub rollout_episodes: usize,
    /// Number of episodes of the buffer that enter the test; more are sampled down.
    pub buffer_episodes: usize,
}

impl Default for Calibrated {
    fn default() -> Self {
        Self {
            doubt: 0.02,
            level: 1e-4,
            min_ratio: 1.1,
            permutations: 100,
            min_episodes: 8,
            rollout_episodes: 20,
            buffer_episodes: 40,
        }
    }
}

/// Settings of the [`Assigner`](crate::Assigner).
///
/// In a file, a field that is missing has its default, and one that does not exist is an error.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AssignerSettings {
    /// Rule that accepts or rejects a policy for a rollout.
    pub rule: Rule,
}

impl AssignerSettings {
    /// Checks that every setting of the assigner is in its range.
    ///
    /// # Errors
    /// The first setting outside its range, with its value.
    pub fn check(&self) -> Result<()> {
        match &self.rule {
            Rule::Fixed { threshold } => {
                let inside = (0.0..f64::INFINITY).contains(threshold);
                within("threshold", *threshold, inside, "a finite number, at least 0")
            }
            Rule::Calibrated(settings) => settings.check(),
        }
    }
}

impl Calibrated {
    fn check(&self) -> Result<()> {
        let level = |value: f64, most: f64| value > 0.0 && value <= most;
        let below_1 = level(self.doubt, 1.0 - f64::EPSILON);
        let expected = "a probability above 0 and below 1";
        within("doubt", self.doubt, below_1, expected)?;
        let expected_level = "a probability above 0 and at most doubt";
        within("level", self.level, level(self.level, self.doubt), expected_level)?;
        let is_ratio = (1.0..f64::INFINITY).contains(&self.min_ratio);
        let expected_ratio = "a finite number, at least 1";
        within("min_ratio", self.min_ratio, is_ratio, expected_ratio)?;
        at_least("permutations", self.permutations, 20, "at least 20")?;
        let smallest = 1.0 / (1.0 + self.permutations as f64);
        let expected_doubt = "at least 1 / (1 + permutations), the smallest exact p-value";
        within("doubt", self.doubt, smallest <= self.doubt, expected_doubt)?;
        let least = self.min_episodes;
        at_least("min_episodes", least, 4, "at least 4")?;
        let expected_episodes = "at least min_episodes";
        at_least("rollout_episodes", self.rollout_episodes, least, expected_episodes)?;
        at_least("buffer_episodes", self.buffer_episodes, least, expected_episodes)
    }

    pub(crate) fn first_look(&self) -> TestSize {
        TestSize {
            rollout: self.rollout_episodes,
            buffer: self.buffer_episodes,
            permutations: self.permutations,
        }
    }

    pub(crate) fn second_look(&self) -> TestSize {
        TestSize {
            rollout: self.rollout_episodes.saturating_mul(2),
            permutations: self.permutations.saturating_mul(4),
            ..self.first_look()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_survive_a_file() {
        let rules = [
            Rule::PAPER,
            Rule::default(),
            Rule::Calibrated(Calibrated {
                level: 3e-5,
                rollout_episodes: 31,
                ..Calibrated::default()
            }),
        ];
        for rule in rules {
            let settings = AssignerSettings { rule };
            let text = serde_json::to_string(&settings).unwrap();
            assert_eq!(serde_json::from_str::<AssignerSettings>(&text).unwrap(), settings);
        }
    }

    #[test]
    fn a_file_may_leave_out_what_is_default_and_may_not_invent() {
        let read = |text| serde_json::from_str::<AssignerSettings>(text);
        assert_eq!(read("{}").unwrap(), AssignerSettings::default());
        let doubtful = read(r#"{"rule": {"calibrated": {"doubt": 0.5}}}"#).unwrap();
        let expected = Calibrated { doubt: 0.5, ..Calibrated::default() };
        assert_eq!(doubtful.rule, Rule::Calibrated(expected));
        for wrong in [
            r#"{"rules": {}}"#,
            r#"{"rule": {"calibrated": {"dout": 0.5}}}"#,
            r#"{"rule": {"fixed": {"threshold": 1.0, "limit": 2.0}}}"#,
        ] {
            let message = read(wrong).unwrap_err().to_string();
            assert!(message.contains("unknown"), "{message}");
        }
    }
}
