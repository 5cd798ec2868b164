//! Comparison of two methods by their scores.

use super::statistics::{Interval, Scores};
use experiments::evaluation::mean;

/// Outcome of the hypothesis "the first method scores above the second", by the 95 % interval of
/// the difference (docs/results/protocol.md).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Interval above zero.
    Confirmed,
    /// Interval below zero.
    Refuted,
    /// Interval that contains zero.
    Undecided,
    /// No interval, since a method has fewer than two seeds.
    TooFewSeeds,
}

/// Differences between two methods over the same groups.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// Mean score of the first method less that of the second.
    pub difference: f64,
    /// 95 % interval of the difference; `None` for fewer than two seeds.
    pub interval: Option<Interval>,
    /// Probability that a run of the first scores above one of the second, and its 95 % interval.
    pub improvement: (f64, Option<Interval>),
}

impl Comparison {
    /// Compares scores of two methods on the same groups.
    pub fn new(one: &Scores, other: &Scores) -> Self {
        Self {
            difference: one.of(mean) - other.of(mean),
            interval: one.difference(other),
            improvement: one.probability_of_improvement(other),
        }
    }

    /// Returns the outcome that the interval of the difference implies.
    pub fn verdict(&self) -> Verdict {
        match self.interval {
            None => Verdict::TooFewSeeds,
            Some(interval) if interval.low > 0.0 => Verdict::Confirmed,
            Some(interval) if interval.high < 0.0 => Verdict::Refuted,
            Some(_) => Verdict::Undecided,
        }
    }
}

impl Verdict {
    /// Returns the text of the outcome in a table.
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
        let high = Scores(vec![vec![0.9, 1.0, 0.95], vec![0.8, 0.9, 0.85]]);
        let low = Scores(vec![vec![0.2, 0.1, 0.3], vec![0.4, 0.3, 0.35]]);
        let one = Scores(vec![vec![0.9], vec![0.8]]);
        let verdict = |ours: &Scores, other: &Scores| Comparison::new(ours, other).verdict();
        assert_eq!(verdict(&high, &low), Verdict::Confirmed);
        assert_eq!(verdict(&low, &high), Verdict::Refuted);
        assert_eq!(verdict(&high, &high), Verdict::Undecided);
        assert_eq!(verdict(&high, &one), Verdict::TooFewSeeds);
    }
}
