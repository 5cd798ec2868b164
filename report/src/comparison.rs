//! One method against another.

use super::statistics::{Interval, Scores};
use experiments::evaluation::mean;

/// What the seeds say of "this method scores above the other".
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The interval of the difference lies above zero.
    Confirmed,
    /// It lies below zero.
    Refuted,
    /// It holds zero.
    Undecided,
    /// There are too few seeds for an interval.
    TooFewSeeds,
}

/// One method against another, over the same groups.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// Difference of mean scores, the first method's less the second's.
    pub difference: f64,
    /// Its 95 % interval.
    pub interval: Option<Interval>,
    /// Probability that a run of the first scores above one of the second, and its interval.
    pub improvement: (f64, Option<Interval>),
}

impl Comparison {
    /// Compares scores `[groups][seeds]`.
    pub fn new(one: &Scores, other: &Scores) -> Self {
        Self {
            difference: one.of(mean) - other.of(mean),
            interval: one.difference(other),
            improvement: one.improvement(other),
        }
    }

    /// What the interval says.
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
    /// The word in a table.
    pub fn word(self) -> &'static str {
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
        let verdict = |one: &Scores, other: &Scores| Comparison::new(one, other).verdict();
        assert_eq!(verdict(&high, &low), Verdict::Confirmed);
        assert_eq!(verdict(&low, &high), Verdict::Refuted);
        assert_eq!(verdict(&high, &high), Verdict::Undecided);
        assert_eq!(verdict(&high, &one), Verdict::TooFewSeeds);
    }
}
