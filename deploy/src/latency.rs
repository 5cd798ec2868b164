//! How long the stages of a trial take.

use std::time::Duration;

/// A stage of a decision; the recognition comes once in a trial.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// The camera's picture is fetched.
    Picture,
    /// It becomes what the policy sees.
    InPainting,
    /// The learner chooses a policy.
    Recognition,
    /// The policy decides.
    Policy,
    /// The decision becomes commands, and the robot takes them.
    Commands,
}

impl Stage {
    /// All, in their order.
    pub const ALL: [Self; 5] =
        [Self::Picture, Self::InPainting, Self::Recognition, Self::Policy, Self::Commands];

    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Picture => "picture",
            Self::InPainting => "in-painting",
            Self::Recognition => "recognition",
            Self::Policy => "policy",
            Self::Commands => "commands",
        }
    }
}

/// Times of all stages.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stages([Vec<Duration>; Stage::ALL.len()]);

impl Stages {
    /// Notes that a stage took so long.
    pub(super) fn note(&mut self, stage: Stage, took: Duration) {
        self.0[stage as usize].push(took);
    }

    /// How often a stage came.
    pub fn count(&self, stage: Stage) -> usize {
        self.0[stage as usize].len()
    }

    /// The median and the largest time of a stage; none where it never came.
    pub fn times(&self, stage: Stage) -> Option<[Duration; 2]> {
        let mut times = self.0[stage as usize].clone();
        times.sort_unstable();
        let median = *times.get(times.len() / 2)?;
        Some([median, *times.last()?])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_have_their_own_times() {
        let mut stages = Stages::default();
        for (index, stage) in Stage::ALL.into_iter().enumerate() {
            assert_eq!(stage as usize, index);
            assert_eq!(stages.times(stage), None);
            for millis in [9, 1, 4] {
                stages.note(stage, Duration::from_millis(millis + index as u64));
            }
        }
        let millis = |[median, most]: [Duration; 2]| [median.as_millis(), most.as_millis()];
        assert_eq!(stages.times(Stage::Picture).map(millis), Some([4, 9]));
        assert_eq!(stages.times(Stage::Commands).map(millis), Some([8, 13]));
        assert_eq!(stages.count(Stage::Policy), 3);
    }
}
