//! Comparison of two methods by their scores.

use super::statistics::{BootstrapInterval, MethodScores};
use experiments::evaluation::mean;

/// Outcome of the hypothesis "the first method scores above the second", by the 95 % interval of
/// the difference (docs/results/protocol.md).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HypothesisOutcome {
    /// Confidence interval of the difference between the methods that lies above zero.
    Confirmed,
    /// Confidence interval of the difference between the methods that lies below zero.
    Refuted,
    /// Confidence interval of the difference between the methods that contains zero.
    Undecided,
    /// No confidence interval, since a method has fewer than two seeds.
    TooFewSeeds,
}

/// Comparison of the scores of two methods on the same task groups.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MethodComparison {
    /// Mean score of the first method minus that of the second.
    pub mean_difference: f64,
    /// 95 % confidence interval of `mean_difference`; `None` for fewer than two seeds.
    pub difference_interval: Option<BootstrapInterval>,
    /// Probability that a run of the first method scores above one of the second, with 95 %
    /// interval.
    pub probability_of_improvement: (f64, Option<BootstrapInterval>),
}

impl MethodComparison {
    /// Compares two methods' scores on the same task groups; a positive difference means that `one`
    /// scores higher than `other`.
    pub fn new(one: &MethodScores, other: &MethodScores) -> Self {
        Self {
            mean_difference: one.pooled_statistic(mean) - other.pooled_statistic(mean),
            difference_interval: one.mean_difference_interval(other),
            probability_of_improvement: one.probability_of_improvement(other),
        }
    }

    /// Returns the outcome of the hypothesis "the first method scores above the second": confirmed
    /// if the interval of the difference lies above zero, refuted if below.
    pub fn outcome(&self) -> HypothesisOutcome {
        match self.difference_interval {
            None => HypothesisOutcome::TooFewSeeds,
            Some(interval) if interval.low > 0.0 => HypothesisOutcome::Confirmed,
            Some(interval) if interval.high < 0.0 => HypothesisOutcome::Refuted,
            Some(_) => HypothesisOutcome::Undecided,
        }
    }
}

impl HypothesisOutcome {
    /// Returns the hypothesis outcome in words, for a table cell.
    pub fn label(self) -> &'static str {
        match self {
            Self::Confirmed => "above",
            Self::Refuted => "below",
            Self::Undecided => "not told apart",
            Self::TooFewSeeds => "too few seeds",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn verdicts_follow_the_interval() {
        let high = MethodScores(vec![vec![0.9, 1.0, 0.95], vec![0.8, 0.9, 0.85]]);
        let low = MethodScores(vec![vec![0.2, 0.1, 0.3], vec![0.4, 0.3, 0.35]]);
        let one = MethodScores(vec![vec![0.9], vec![0.8]]);
        let verdict = |ours: &MethodScores, other: &MethodScores| {
            MethodComparison::new(ours, other).outcome()
        };
        assert_eq!(verdict(&high, &low), HypothesisOutcome::Confirmed);
        assert_eq!(verdict(&low, &high), HypothesisOutcome::Refuted);
        assert_eq!(verdict(&high, &high), HypothesisOutcome::Undecided);
        assert_eq!(verdict(&high, &one), HypothesisOutcome::TooFewSeeds);
    }
}
