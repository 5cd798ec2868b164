//! Latencies of the stages of a trial.

use std::time::Duration;

/// Stage of a decision on a robot; a [`LatencyProfile`] holds its times. The recognition runs once
/// per trial.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DecisionStage {
    /// Fetching the camera's picture.
    FetchPicture,
    /// Removing the arm from the picture.
    InPainting,
    /// Choice of a policy by the learner from the first picture.
    ChoosePolicy,
    /// Choice of an action by the policy.
    ChooseAction,
    /// Computing the commands of a decision and sending them to the robot.
    SendCommands,
}

impl DecisionStage {
    /// All stages of a decision, in the order in which they run.
    pub const ALL: [Self; 5] = [
        Self::FetchPicture,
        Self::InPainting,
        Self::ChoosePolicy,
        Self::ChooseAction,
        Self::SendCommands,
    ];

    /// Returns the stage's name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::FetchPicture => "picture",
            Self::InPainting => "in-painting",
            Self::ChoosePolicy => "recognition",
            Self::ChooseAction => "policy",
            Self::SendCommands => "commands",
        }
    }
}

/// Measured times of all stages of the decisions on a robot.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LatencyProfile([Vec<Duration>; DecisionStage::ALL.len()]);

impl LatencyProfile {
    /// Adds the time that a stage of a decision took.
    pub(super) fn record(&mut self, stage: DecisionStage, took: Duration) {
        self.0[stage as usize].push(took);
    }

    /// Returns the number of times that a stage was measured.
    pub fn measurement_count(&self, stage: DecisionStage) -> usize {
        self.0[stage as usize].len()
    }

    /// Returns the median and the largest time of a stage, or `None` if it never ran.
    pub fn median_and_max(&self, stage: DecisionStage) -> Option<[Duration; 2]> {
        let mut times = self.0[stage as usize].clone();
        times.sort_unstable();
        let middle = times.len() / 2;
        let upper = *times.get(middle)?;
        let is_even = times.len().is_multiple_of(2);
        let median = if is_even { (times[middle - 1] + upper) / 2 } else { upper };
        Some([median, *times.last()?])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_have_their_own_times() {
        let mut latencies = LatencyProfile::default();
        for (index, stage) in DecisionStage::ALL.into_iter().enumerate() {
            assert_eq!(stage as usize, index);
            assert_eq!(latencies.median_and_max(stage), None);
            for millis in [9, 1, 4] {
                latencies.record(stage, Duration::from_millis(millis + index as u64));
            }
        }
        let millis = |[median, most]: [Duration; 2]| [median.as_millis(), most.as_millis()];
        assert_eq!(latencies.median_and_max(DecisionStage::FetchPicture).map(millis), Some([4, 9]));
        assert_eq!(
            latencies.median_and_max(DecisionStage::SendCommands).map(millis),
            Some([8, 13])
        );
        assert_eq!(latencies.measurement_count(DecisionStage::ChooseAction), 3);
        // of an even number, the mean of the two in the middle
        latencies.record(DecisionStage::FetchPicture, Duration::from_millis(6));
        assert_eq!(latencies.median_and_max(DecisionStage::FetchPicture).map(millis), Some([5, 9]));
    }
}
