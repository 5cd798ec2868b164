//! Groupings without evidence: one policy for each label, the upper bound that the paper calls
//! COVERS-GT, and one policy for everything.

use std::sync::{Arc, Mutex, PoisonError};

use cluster::Decision;
use rand_chacha::ChaCha8Rng;
use serde::Deserialize;
use serde_json::Value;

use crate::error::LearnerError;

use super::grouping::{Candidates, Grouping, GroupingDecision, Learned, Lesson, Query};

/// Grouping that assigns every rollout to policy 0: the paper's baselines Equi and CNN.
#[derive(Clone, Copy, Debug, Default)]
pub struct Single;

impl Grouping for Single {
    fn assign(
        &mut self,
        _: Query<'_>,
        _: &mut dyn Candidates,
        _: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        Ok(GroupingDecision::of(Decision::Existing(0)))
    }
}

/// Ground-truth label of the present task group, written by a run and read by an oracle.
#[derive(Clone, Debug, Default)]
pub struct Labels(Arc<Mutex<Option<String>>>);

impl Labels {
    /// Sets the label of the task group that runs from here on.
    pub fn set(&self, group: &str) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(group.to_owned());
    }

    fn get(&self) -> Option<String> {
        let label = self.0.lock();
        label.unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Grouping that creates one policy for each ground-truth label of a task group; the other
/// groupings receive no labels.
#[derive(Debug)]
pub struct Oracle {
    labels: Labels,
    /// Label of the task group of each policy.
    known: Vec<String>,
}

impl Oracle {
    /// Creates a grouping that reads the labels written by a run.
    pub(crate) fn new(labels: Labels) -> Self {
        Self { labels, known: Vec::new() }
    }

    fn policy(&self, label: &str) -> Option<usize> {
        self.known.iter().position(|known| known == label)
    }
}

impl Grouping for Oracle {
    fn assign(
        &mut self,
        query: Query<'_>,
        _: &mut dyn Candidates,
        _: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        let label = self.labels.get().ok_or_else(unlabelled)?;
        let policy = self.policy(&label);
        // the label may change before the new policy trains, so it is recorded here
        if policy.is_none() && !matches!(query, Query::Recognition) {
            self.known.push(label);
        }
        let decision = policy.map_or(Decision::New, Decision::Existing);
        Ok(GroupingDecision::of(decision))
    }

    /// Records the label of the very first rollout, for which there is no query.
    fn learn(&mut self, _: Lesson<'_>, _: &mut ChaCha8Rng) -> Result<Learned, LearnerError> {
        if self.known.is_empty() {
            self.known.push(self.labels.get().unwrap_or_default());
        }
        Ok(Learned::default())
    }

    fn state(&self) -> Value {
        self.known.clone().into()
    }

    fn restore(&mut self, state: &Value, policies: usize) -> Result<(), String> {
        let known: Vec<String> = Vec::deserialize(state).map_err(|error| error.to_string())?;
        // before the first rollout there is policy 0, but no label yet
        if known.len() != policies && !(known.is_empty() && policies == 1) {
            return Err(format!("{} labels of {policies} policies", known.len()));
        }
        self.known = known;
        Ok(())
    }
}

/// Returns the error of the grouping [`Oracle`] if no label was set.
pub(super) fn unlabelled() -> LearnerError {
    LearnerError::InvalidSetting {
        name: "grouping",
        value: "oracle".to_owned(),
        expected: "a grouping without labels, or a learner that a run trains: only runs and their \
                   evaluations know labels",
    }
}

#[cfg(test)]
mod tests {
    use cluster::{Candidate, Contest};
    use rand::SeedableRng;

    use super::*;
    use crate::groupings::grouping::Episodes;

    const ROLLOUT: Query<'static> = Query::Rollout { can_wait: true };

    /// An oracle must not look at pictures.
    struct Blind;

    impl Candidates for Blind {
        fn clouds(&mut self) -> Result<Vec<Candidate>, LearnerError> {
            panic!("an oracle does not compare")
        }

        fn contests(&mut self, _: [usize; 2], _: usize) -> Result<[Contest; 2], LearnerError> {
            panic!("an oracle does not compare")
        }

        fn episodes(&self) -> Episodes<'_> {
            panic!("an oracle does not look")
        }
    }

    fn ask(oracle: &mut Oracle, query: Query<'_>) -> Result<Decision, LearnerError> {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        Ok(oracle.assign(query, &mut Blind, &mut rng)?.policy)
    }

    #[test]
    fn every_label_has_a_policy_and_looking_opens_none() {
        let labels = Labels::default();
        let mut oracle = Oracle::new(labels.clone());
        let message = ask(&mut oracle, ROLLOUT).unwrap_err().to_string();
        assert!(message.contains("a grouping without labels"), "{message}");
        labels.set("a");
        let first = Lesson::Probes { policy: 0, probes: &[] };
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        oracle.learn(first, &mut rng).unwrap();
        let mut look = |label: &str, query| {
            labels.set(label);
            ask(&mut oracle, query).unwrap()
        };
        assert_eq!(look("a", ROLLOUT), Decision::Existing(0));
        assert_eq!(look("b", Query::Recognition), Decision::New);
        assert_eq!(look("c", ROLLOUT), Decision::New);
        assert_eq!(look("c", Query::Recognition), Decision::Existing(1));
        assert_eq!(look("a", ROLLOUT), Decision::Existing(0));
        assert_eq!(look("b", ROLLOUT), Decision::New, "it was looked at");
        let state = oracle.state();
        let mut restored = Oracle::new(labels.clone());
        restored.restore(&state, 3).unwrap();
        let again = ask(&mut restored, ROLLOUT).unwrap();
        assert_eq!(again, Decision::Existing(2));
        assert!(restored.restore(&state, 4).is_err());
        assert!(restored.restore(&Value::from(3), 2).is_err());
    }
}
