//! Settings of the assigner.

use crate::ClusterError;
use crate::check::at_least;
use crate::permutation::PermutationTest;

/// How the assigner decides whether a rollout belongs to a policy's group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rule {
    /// The paper's rule: `W1(O, B_j) <= threshold`, nearest policy first. Depends on the scale of
    /// the features.
    Fixed {
        /// Largest distance within a group (`d_epsilon`), in the features' unit.
        threshold: f64,
    },
    /// A two-sample permutation test by whole episodes. Does not depend on the scale of the
    /// features.
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

/// Settings of the calibrated rule.
///
/// A rollout is refused if its score *and* its ratio exceed their limits, or if its score alone
/// exceeds `certain_score`. Where the limits come from is told in the crate's README.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibrated {
    /// Random splits of the pooled episodes that make up the null distribution, at least 20. More splits raise their largest
    /// distance, so `max_ratio` belongs to this number.
    pub permutations: usize,
    /// Largest score `(W1 - mean) / sd` within a group, in standard deviations of the null
    /// distribution.
    pub max_score: f64,
    /// Score above which a rollout is refused whatever its ratio; at least `max_score`. It matters
    /// for features that vary in many directions: there all distances are alike, and the ratio
    /// stays near 1.
    pub certain_score: f64,
    /// Largest ratio of `W1` to the largest distance under the null distribution within a group.
    pub max_ratio: f64,
    /// Episodes that each side must hold for the test to mean something, at least 4.
    pub min_episodes: usize,
    /// Episodes of the rollout that enter the test; more are sampled down.
    pub rollout_episodes: usize,
    /// Episodes of the buffer that enter the test; more are sampled down.
    pub buffer_episodes: usize,
}

impl Calibrated {
    /// The limits of the README's study.
    pub const DEFAULT: Self = Self {
        permutations: 60,
        max_score: 3.5,
        certain_score: 6.0,
        max_ratio: 1.12,
        min_episodes: 8,
        rollout_episodes: 20,
        buffer_episodes: 40,
    };
}

impl Default for Calibrated {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Settings of the [`Assigner`](crate::Assigner).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AssignerSettings {
    /// The rule that accepts or refuses a group.
    pub rule: Rule,
}

impl AssignerSettings {
    /// Checks every range.
    ///
    /// # Errors
    /// The first setting outside its range, with its value.
    pub fn check(&self) -> Result<(), ClusterError> {
        match &self.rule {
            Rule::Fixed { threshold } => non_negative("threshold", *threshold),
            Rule::Calibrated(settings) => settings.check(),
        }
    }
}

impl Calibrated {
    fn check(&self) -> Result<(), ClusterError> {
        at_least("permutations", self.permutations, 20, "at least 20")?;
        at_least("min_episodes", self.min_episodes, 4, "at least 4")?;
        let needed = "at least min_episodes";
        at_least(
            "rollout_episodes",
            self.rollout_episodes,
            self.min_episodes,
            needed,
        )?;
        at_least(
            "buffer_episodes",
            self.buffer_episodes,
            self.min_episodes,
            needed,
        )?;
        non_negative("max_score", self.max_score)?;
        non_negative("max_ratio", self.max_ratio)?;
        non_negative("certain_score", self.certain_score)?;
        if self.certain_score < self.max_score {
            let (name, value) = ("certain_score", self.certain_score);
            return Err(ClusterError::OutOfRange {
                name,
                value,
                expected: "at least max_score",
            });
        }
        Ok(())
    }

    /// Returns whether a test speaks for one group.
    pub(crate) fn accepts(&self, test: &PermutationTest) -> bool {
        let both = test.score > self.max_score && test.ratio > self.max_ratio;
        !(both || test.score > self.certain_score)
    }
}

fn non_negative(name: &'static str, value: f64) -> Result<(), ClusterError> {
    if value.is_finite() && value >= 0.0 {
        return Ok(());
    }
    let expected = "a finite number, at least 0";
    Err(ClusterError::OutOfRange {
        name,
        value,
        expected,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refuses_by_score_and_ratio_together_or_by_a_certain_score() {
        let cases = [
            (0.0, 0.9, true),
            (3.5, 9.0, true),
            (3.6, 1.12, true),
            (3.6, 1.13, false),
            (6.0, 1.12, true),
            (6.1, 0.9, false),
        ];
        for (score, ratio, accepted) in cases {
            let test = PermutationTest {
                distance: 1.0,
                mean: 1.0,
                sd: 1.0,
                max: 1.0,
                score,
                ratio,
            };
            assert_eq!(
                Calibrated::default().accepts(&test),
                accepted,
                "{score}, {ratio}"
            );
        }
    }
}
